"""The sensors: from light to an 8-bit image, and from true depth to structured-light readings."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic.config import ColorSensorModel, DepthSensorModel
from drivers.synthetic.raycast import FAR_M, Floats

MAX_BLUR_TAPS = 12
# Rows exposed at a time; few enough that the temporary arrays stay in the processor's cache.
BAND_ROWS = 32
MID_GRAY = 128.0
# Slow hunting of the automatic exposure: relative amplitude, frequency in hertz, phase in radians.
GAIN_WAVES = ((0.7, 0.11, 0.3), (0.3, 0.43, 1.9))


Image = NDArray[np.uint8]
Depth = NDArray[np.uint16]


@dataclass(frozen=True)
class RenderedImages:
    """Color (H, W, 3) uint8 BGR and depth registered to it (H, W) uint16, both undistorted."""

    color_bgr: Image
    depth_raw: Depth


def gain_at(sensor: ColorSensorModel, time_s: float, duration_s: float) -> float:
    """Compute the exposure gain at a time; it has whole periods in `duration_s` for looping."""
    total = 0.0
    for part, frequency, phase in GAIN_WAVES:
        periods = max(1.0, round(frequency * duration_s))
        total += part * np.sin(2 * np.pi * periods * time_s / duration_s + phase)
    return 1.0 + sensor.gain_drift * float(total)


def vignetting_map(camera: PinholeCamera, loss: float) -> Floats:
    """Compute the relative brightness (H, W) of each pixel; it is 1 - `loss` in the corners."""
    x = (np.arange(camera.width) - camera.cx) / (0.5 * camera.width)
    y = (np.arange(camera.height) - camera.cy) / (0.5 * camera.height)
    brightness = 1.0 - 0.5 * loss * (x**2 + (y**2)[:, None])
    return brightness.astype(np.float32)


def expose(
    image: Floats,
    gain: float,
    vignetting: Floats,
    sensor: ColorSensorModel,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Expose an image (H, W, 3) to uint8.

    At mid gray, half of the noise's power is shot noise and half is read-out noise.

    Args:
        image: (H, W, 3) float32, 0 to 255.
        gain: Exposure gain; 1 is the mean.
        vignetting: (H, W) relative brightness.
    """
    if sensor.softness_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), sensor.softness_px)  # type: ignore[assignment]
    result = np.empty(image.shape, dtype=np.uint8)
    for top in range(0, len(image), BAND_ROWS):
        rows = slice(top, top + BAND_ROWS)
        exposed = image[rows] * (np.float32(gain) * vignetting[rows])[..., None]
        if sensor.noise_sigma > 0:
            sigma = sensor.noise_sigma * np.sqrt(0.5 + exposed * np.float32(0.5 / MID_GRAY))
            exposed += sigma * rng.standard_normal(exposed.shape, dtype=np.float32)
        result[rows] = np.clip(exposed + np.float32(0.5), 0, 255)
    return result


@kernel
def motion_blur(
    image: Floats,
    rays: Array,
    depth_m: Floats,
    body: NDArray[np.int64],
    T_opening_now: Array,
    T_closing_now: Array,
    focal_px: float,
) -> Floats:
    """Average `image` along each pixel's motion from the shutter's opening to its closing.

    Args:
        image: (H, W, 3).
        rays: (H, W, 2) on the plane z = 1.
        depth_m: (H, W).
        body: (H, W) index of the body that each pixel sees.
        T_opening_now: (B, H, 4, 4) maps a body's points from a row's camera coordinates at the
            row's own instant to those at the beginning of its exposure.
        T_closing_now: The same to the end of its exposure.
        focal_px: Focal length of `image`.
    """
    height, width = depth_m.shape
    blurred = np.empty_like(image)
    total = np.empty(3)
    for v in range(height):
        for u in range(width):
            x, y, z = rays[v, u, 0], rays[v, u, 1], depth_m[v, u]
            ax, ay = _project_transformed(T_opening_now, body[v, u], v, x, y, z)
            bx, by = _project_transformed(T_closing_now, body[v, u], v, x, y, z)
            du, dv = focal_px * (bx - ax), focal_px * (by - ay)
            taps = 1 + min(MAX_BLUR_TAPS - 1, int(math.sqrt(du * du + dv * dv) + 0.5))
            total[:] = 0.0
            for k in range(taps):
                # Sample against the motion: there the surface was when its light arrived.
                along = (k + 0.5) / taps - 0.5
                i = min(max(u - along * du, 0.0), width - 1.001)
                j = min(max(v - along * dv, 0.0), height - 1.001)
                column, row = int(i), int(j)
                p, q = np.float32(i - column), np.float32(j - row)
                w00, w01 = (1 - p) * (1 - q), p * (1 - q)
                w10, w11 = (1 - p) * q, p * q
                for c in range(3):
                    total[c] += (
                        w00 * image[row, column, c]
                        + w01 * image[row, column + 1, c]
                        + w10 * image[row + 1, column, c]
                        + w11 * image[row + 1, column + 1, c]
                    )
            for c in range(3):
                blurred[v, u, c] = total[c] / taps
    return blurred


@kernel
def _project_transformed(
    T: Array, b: int, v: int, x: float, y: float, z: float
) -> tuple[float, float]:
    """Project the point (x, y, 1) z onto the plane z = 1 after the rigid motion T[b, v]."""
    depth = T[b, v, 2, 0] * x + T[b, v, 2, 1] * y + T[b, v, 2, 2] + T[b, v, 2, 3] / z
    return (
        (T[b, v, 0, 0] * x + T[b, v, 0, 1] * y + T[b, v, 0, 2] + T[b, v, 0, 3] / z) / depth,
        (T[b, v, 1, 0] * x + T[b, v, 1, 1] * y + T[b, v, 1, 2] + T[b, v, 1, 3] / z) / depth,
    )


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
        x, y: Undistorted point on the plane z = 1.
        k: (5,) k1 k2 p1 p2 k3, the order of OpenCV.
    """
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )
