"""From the light that reaches the lens to an 8-bit image: blur, vignetting, exposure, noise."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic import ColorSensorModel
from drivers.synthetic.raycast import Floats

MAX_BLUR_TAPS = 12
# Rows exposed at a time; few enough that the temporary arrays stay in the processor's cache.
BAND_ROWS = 32
MID_GRAY = 128.0
# Slow hunting of the automatic exposure: relative amplitude, frequency in hertz, phase in radians.
GAIN_WAVES = ((0.7, 0.11, 0.3), (0.3, 0.43, 1.9))


def gain_at(sensor: ColorSensorModel, time_s: float, duration_s: float) -> float:
    """Compute the exposure gain at a time; it has whole periods in `duration_s` for looping.

    Args:
        sensor: Gives the drift.
        time_s: Time from the first frame, s.
        duration_s: Length of the sequence, s.
    """
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
        sensor: Softness and noise.
        rng: Random generator of the noise.
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
