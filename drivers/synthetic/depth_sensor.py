"""From true depth to the readings of a structured-light sensor.

The projector stands to the right of the infrared camera. Disparity is focal * baseline / depth;
its noise and its step are constant, so both grow with depth squared (Khoshelham and Elberink,
Accuracy and resolution of Kinect depth data, Sensors 2012, equation 10). Edges are ragged as in
Handa et al., A benchmark for RGB-D visual odometry, ICRA 2014, section IV.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic import DepthSensorModel
from drivers.synthetic.raycast import FAR_M, Floats

# The sensor matches windows of 9 x 9 pixels, so neighbors share their errors.
NOISE_BLUR_PX = 1.2
KINECT_WIDTH_PX = 640
SHADOW_TOLERANCE_PX = 1.5


def infrared_camera(sensor: DepthSensorModel, color_camera: PinholeCamera) -> PinholeCamera:
    """Intrinsics of the infrared image, for a color image of any size."""
    focal_px = sensor.focal_px * color_camera.width / KINECT_WIDTH_PX
    cx, cy = (color_camera.width - 1) / 2, (color_camera.height - 1) / 2
    return PinholeCamera(color_camera.width, color_camera.height, focal_px, focal_px, cx, cy)


def measure_depth(depth_m: Floats, sensor: DepthSensorModel, rng: np.random.Generator) -> Floats:
    """Simulate the sensor's readings.

    Args:
        depth_m: True depth (H, W).
        sensor: The sensor's parameters.
        rng: Generator of the noise.

    Returns:
        Measured depth (H, W) in meters, 0 = no reading.
    """
    true_m = _jitter_edges(depth_m, sensor.lateral_sigma_px, rng)
    scale = sensor.focal_px * sensor.baseline_m
    disparity_px = np.float32(scale) / true_m
    hidden = np.zeros(depth_m.shape, dtype=np.bool_)
    if sensor.shadows:
        # In pixels of this image, which may be smaller than a Kinect's.
        hidden = find_shadows(disparity_px * np.float32(depth_m.shape[1] / KINECT_WIDTH_PX))
    if sensor.disparity_sigma_px > 0:
        disparity_px += sensor.disparity_sigma_px * _correlated_noise(depth_m.shape, rng)
    if sensor.disparity_step_px > 0:
        disparity_px = np.rint(disparity_px / sensor.disparity_step_px) * sensor.disparity_step_px
    with np.errstate(divide="ignore"):
        measured_m = np.float32(scale) / disparity_px
    valid = (measured_m >= sensor.min_range_m) & (measured_m <= sensor.max_range_m) & ~hidden
    return np.where(valid & (depth_m < FAR_M), measured_m, 0).astype(np.float32)


def _jitter_edges(depth_m: Floats, sigma_px: float, rng: np.random.Generator) -> Floats:
    """Give each pixel the depth of a neighbor `sigma_px` away on average."""
    if sigma_px == 0:
        return depth_m
    height, width = depth_m.shape
    columns = np.arange(width, dtype=np.float32) + sigma_px * _correlated_noise(depth_m.shape, rng)
    rows = np.arange(height, dtype=np.float32)[:, None] + sigma_px * _correlated_noise(
        depth_m.shape, rng
    )
    flags, border = cv2.INTER_NEAREST, cv2.BORDER_REPLICATE
    return cv2.remap(depth_m, columns, rows, flags, borderMode=border)  # type: ignore[return-value]


def _correlated_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Noise (H, W) of unit deviation, correlated between neighbors."""
    white = rng.standard_normal(shape, dtype=np.float32)
    # A Gaussian of width s leaves 1 / (4 pi s^2) of white noise's power.
    gain = np.float32(2.0 * np.sqrt(np.pi) * NOISE_BLUR_PX)
    return gain * cv2.GaussianBlur(white, (0, 0), NOISE_BLUR_PX)


@kernel
def find_shadows(disparity_px: Floats) -> NDArray[np.bool_]:
    """Mark the pixels (H, W) whose point is hidden from the projector.

    The point of column u is in the projector's column u - disparity. The projector lights only the
    nearest point of a column.
    """
    height, width = disparity_px.shape
    hidden = np.zeros((height, width), dtype=np.bool_)
    reach = int(np.max(disparity_px)) + 3
    nearest = np.empty(width + reach)
    for v in range(height):
        nearest[:] = 0.0
        for u in range(width):
            d = disparity_px[v, u]
            column = u - d + reach
            for k in (int(column), int(column) + 1):
                if 0 <= k < len(nearest):
                    nearest[k] = max(nearest[k], d)
        for u in range(width):
            d = disparity_px[v, u]
            k = int(u - d + reach + 0.5)
            hidden[v, u] = nearest[k] > d + SHADOW_TOLERANCE_PX
    return hidden


@kernel
def register_depth(
    measured_m: Floats,
    infrared: tuple[float, float, float],
    color: tuple[float, float, float, float],
    distortion: Array,
    infrared_offset_m: float,
    factor: float,
) -> NDArray[np.uint16]:
    """Register depth to the color camera's raw, distorted image.

    Each reading goes to the pixel onto which its point projects; the nearest reading wins.

    Args:
        measured_m: Depth (H, W) of the infrared camera, 0 = no reading.
        infrared: Focal length, cx and cy of the infrared camera.
        color: Focal lengths and center fx, fy, cx, cy of the color camera.
        distortion: k1 k2 p1 p2 k3 of the color camera.
        infrared_offset_m: Distance of the infrared camera to the left of the color camera.
        factor: Depth value of one meter.

    Returns:
        Depth values (H, W), 0 = no reading.
    """
    height, width = measured_m.shape
    focal, cx, cy = infrared
    result = np.zeros((height, width), dtype=np.uint16)
    for v in range(height):
        for u in range(width):
            z = measured_m[v, u]
            if z <= 0.0:
                continue
            x, y = distort((u - cx) / focal - infrared_offset_m / z, (v - cy) / focal, distortion)
            column = math.floor(color[0] * x + color[2] + 0.5)
            row = math.floor(color[1] * y + color[3] + 0.5)
            if 0 <= column < width and 0 <= row < height:
                reading = min(z * factor + 0.5, 65535.0)
                if result[row, column] == 0 or reading < result[row, column]:
                    result[row, column] = np.uint16(reading)
    return result


@kernel
def distort(x: float, y: float, k: Array) -> tuple[float, float]:
    """Distort a point by Brown's model; `k` in OpenCV's order: k1 k2 p1 p2 k3.

    Args:
        x: Undistorted point on the plane z = 1.
        y: The same.
        k: (5,) k1 k2 p1 p2 k3, the order of OpenCV.
    """
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )
