"""Where a pixel of a played Kinect's depth camera lies in its color camera's image.

A Kinect keeps in its memory how its depth image is to be warped; libfreenect reads that when it
opens the camera, together with the constants of the depth itself (`depth_scale`).
"""

from dataclasses import dataclass

from tests.simulators.raw_depth import NOMINAL, RawDepthScale, mm_to_raw, quantize_mm, raw_to_mm

__all__ = [
    "FACTORY",
    "IDENTITY",
    "RegistrationTable",
    "mm_to_raw",
    "quantize_mm",
    "raw_to_mm",
]

# What libfreenect always does between the camera's own numbers and a pixel: it adds one pixel and
# 3/8, and takes the two cameras to be 2.4 cm apart, whatever the Kinect says.
_EXTRA_SHIFT_PX = 1.0
_EXTRA_COLUMNS_PX = 0.375
_BASELINE_CM = 2.4
_REPORTED_BASELINE_CM = 2.3

# Fixed point: the first values in 1/256 pixel, the slopes in 1/32768 pixel a pixel.
_UNITS_PER_PIXEL = 256
_UNITS_PER_SLOPE = 32768
# Where they stand among the 29 numbers of the map's polynomial.
_X_START, _Y_START, _X_SLOPE, _Y_SLOPE, _NUMBERS = 5, 10, 17, 20, 29

# Kinect v1, color and depth camera (nominal): focal length and centre of 640x480 images.
_COLOR_FOCAL_PX = 525.0
_CENTER_PX = (319.5, 239.5)


@dataclass(frozen=True)
class RegistrationTable:
    """`polynomial` maps depth pixels to color pixels; `magnification` see IDENTITY."""

    polynomial: tuple[int, ...]
    magnification: float = 1.0

    def zero_plane(self, scale: RawDepthScale) -> tuple[float, float, float, float]:
        """As the camera sends it: emitter, color camera, reference plane, pixel; cm."""
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


def _make_factory_table() -> RegistrationTable:
    """A Kinect as made: color camera 2.4 cm beside the depth camera, with a wider view."""
    slope = _COLOR_FOCAL_PX / NOMINAL.focal_px - 1.0
    # libfreenect shifts columns by this much at infinity, and by nothing at the reference distance.
    at_infinity_px = _BASELINE_CM / (2.0 * NOMINAL.pixel_cm)
    x = -slope * _CENTER_PX[0] - at_infinity_px - _EXTRA_SHIFT_PX - _EXTRA_COLUMNS_PX + 0.5
    y = -slope * _CENTER_PX[1] - _EXTRA_SHIFT_PX + 0.5
    return RegistrationTable(_polynomial((x, y), slope))


def _make_identity_table() -> RegistrationTable:
    """Registering moves nothing, for depth that is registered already.

    libfreenect's shift by distance cannot be switched off, but it goes with 1 / pixel size, while
    millimetres depend only on pixel size / emitter distance: both times 2^20 leave the
    millimetres as they are, bit for bit, and make the shift a millionth. No real lens has such
    numbers: give a camera file instead of believing them.
    """
    return RegistrationTable(_polynomial((-_EXTRA_SHIFT_PX, -_EXTRA_SHIFT_PX), 0.0), float(1 << 20))


FACTORY = _make_factory_table()
IDENTITY = _make_identity_table()
