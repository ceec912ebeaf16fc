"""Depth registration of a simulated Kinect: depth camera pixels to color camera pixels.

A Kinect stores this map in its memory. libfreenect reads it when it opens the camera, together with
the constants of the depth itself (raw_depth.py).
"""

from dataclasses import dataclass

from tests.simulators.raw_depth import NOMINAL, RawDepthScale, mm_to_raw, quantize_mm, raw_to_mm

__all__ = [
    "FACTORY",
    "IDENTITY",
    "RegistrationTable",
    "make_factory_table",
    "mm_to_raw",
    "quantize_mm",
    "raw_to_mm",
]

# libfreenect always adds one pixel and 3/8 to the camera's own map. It assumes that the two cameras
# are 2.4 cm apart, whatever the Kinect reports.
_EXTRA_SHIFT_PX = 1.0
_EXTRA_COLUMNS_PX = 0.375
_BASELINE_CM = 2.4
_REPORTED_BASELINE_CM = 2.3

# Fixed point: the first values in 1/256 pixel, the slopes in 1/32768 pixel per pixel.
_UNITS_PER_PIXEL = 256
_UNITS_PER_SLOPE = 32768
# Their indices among the 29 numbers of the map's polynomial.
_X_START, _Y_START, _X_SLOPE, _Y_SLOPE, _NUMBERS = 5, 10, 17, 20, 29

# Kinect v1, color and depth camera (nominal): focal length and center of 640x480 images.
_COLOR_FOCAL_PX = 525.0
_CENTER_PX = (319.5, 239.5)


@dataclass(frozen=True)
class RegistrationTable:
    """The registration of a Kinect.

    Attributes:
        polynomial: Maps depth pixels to color pixels.
        magnification: Factor on the emitter distance and the pixel size; see
            `_make_identity_table`.
    """

    polynomial: tuple[int, ...]
    magnification: float = 1.0

    def zero_plane(self, scale: RawDepthScale) -> tuple[float, float, float, float]:
        """Constants that the camera sends: emitter, color camera, reference plane, pixel; cm."""
        return (
            scale.emitter_cm * self.magnification,
            _REPORTED_BASELINE_CM,
            scale.reference_cm,
            scale.pixel_cm * self.magnification,
        )


def _polynomial(shift_px: tuple[float, float], slope: float) -> tuple[int, ...]:
    numbers = [0] * _NUMBERS
    numbers[_X_START] = round(shift_px[0] * _UNITS_PER_PIXEL)
    numbers[_Y_START] = round(shift_px[1] * _UNITS_PER_PIXEL)
    numbers[_X_SLOPE] = numbers[_Y_SLOPE] = round(slope * _UNITS_PER_SLOPE)
    return tuple(numbers)


def make_factory_table(color_focal_px: float = _COLOR_FOCAL_PX) -> RegistrationTable:
    """Make the table of a real Kinect: color camera 2.4 cm beside the depth camera, wider view."""
    slope = color_focal_px / NOMINAL.focal_px - 1.0
    # libfreenect shifts columns by this at infinity, and not at all at the reference distance.
    at_infinity_px = _BASELINE_CM / (2.0 * NOMINAL.pixel_cm)
    x = -slope * _CENTER_PX[0] - at_infinity_px - _EXTRA_SHIFT_PX - _EXTRA_COLUMNS_PX + 0.5
    y = -slope * _CENTER_PX[1] - _EXTRA_SHIFT_PX + 0.5
    return RegistrationTable(_polynomial((x, y), slope))


def _make_identity_table() -> RegistrationTable:
    """Make a table that moves nothing, for depth that is registered already.

    libfreenect's shift by distance cannot be switched off. It is proportional to 1 / pixel size,
    while depth depends only on pixel size / emitter distance. Both times 2^20 keep the depth bit
    for bit and divide the shift by a million. No real lens has such numbers, so a program needs a
    camera file.
    """
    return RegistrationTable(_polynomial((-_EXTRA_SHIFT_PX, -_EXTRA_SHIFT_PX), 0.0), float(1 << 20))


FACTORY = make_factory_table()
IDENTITY = _make_identity_table()
