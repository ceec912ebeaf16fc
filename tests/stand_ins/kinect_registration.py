"""Where a pixel of a played Kinect's depth camera lies in its colour camera's image.

A Kinect keeps in its memory how its depth image is to be warped; libfreenect reads that when it
opens the camera, together with the constants of the depth itself (`depth_scale`).
"""

from dataclasses import dataclass

from tests.stand_ins.depth_scale import (
    NOMINAL,
    DepthScale,
    expected_mm,
    quantised_mm,
    raw_of_mm,
)

__all__ = [
    "FACTORY",
    "IDENTITY",
    "Registration",
    "expected_mm",
    "quantised_mm",
    "raw_of_mm",
]

# What libfreenect always does between the camera's own numbers and a pixel: it adds one pixel and
# 3/8, and takes the two cameras to be 2.4 cm apart, whatever the Kinect says.
_ADDED_PX = 1.0
_ADDED_COLUMNS_PX = 0.375
_CAMERAS_APART_CM = 2.4
_TOLD_CM = 2.3

# Fixed point: the first values in 1/256 pixel, the slopes in 1/32768 pixel a pixel.
_PER_PIXEL = 256
_PER_SLOPE = 32768
# Where they stand among the 29 numbers of the map's polynomial.
_X_START, _Y_START, _X_SLOPE, _Y_SLOPE, _NUMBERS = 5, 10, 17, 20, 29

# Kinect v1, colour and depth camera (nominal): focal length and centre of 640x480 images.
_COLOUR_FOCAL_PX = 525.0
_CENTRE_PX = (319.5, 239.5)


@dataclass(frozen=True)
class Registration:
    """`polynomial` maps depth pixels to colour pixels; `magnification` see IDENTITY."""

    polynomial: tuple[int, ...]
    magnification: float = 1.0

    def zero_plane(self, scale: DepthScale) -> tuple[float, float, float, float]:
        """As the camera sends it: emitter, colour camera, reference plane, pixel; cm."""
        return (
            scale.emitter_cm * self.magnification,
            _TOLD_CM,
            scale.reference_cm,
            scale.pixel_cm * self.magnification,
        )


def _polynomial(shift_px: tuple[float, float], slope: float) -> tuple[int, ...]:
    numbers = [0] * _NUMBERS
    numbers[_X_START] = round(shift_px[0] * _PER_PIXEL)
    numbers[_Y_START] = round(shift_px[1] * _PER_PIXEL)
    numbers[_X_SLOPE] = numbers[_Y_SLOPE] = round(slope * _PER_SLOPE)
    return tuple(numbers)


def _factory() -> Registration:
    """A Kinect as made: colour camera 2.4 cm beside the depth camera, with a wider view."""
    slope = _COLOUR_FOCAL_PX / NOMINAL.focal_px - 1.0
    # libfreenect shifts columns by this much at infinity, and by nothing at the reference distance.
    at_infinity_px = _CAMERAS_APART_CM / (2.0 * NOMINAL.pixel_cm)
    x = -slope * _CENTRE_PX[0] - at_infinity_px - _ADDED_PX - _ADDED_COLUMNS_PX + 0.5
    y = -slope * _CENTRE_PX[1] - _ADDED_PX + 0.5
    return Registration(_polynomial((x, y), slope))


def _identity() -> Registration:
    """Registering moves nothing, for depth that is registered already.

    libfreenect's shift by distance cannot be switched off, but it goes with 1 / pixel size, while
    millimetres depend only on pixel size / emitter distance: both times 2^20 leave the
    millimetres as they are, bit for bit, and make the shift a millionth. No real lens has such
    numbers: give a camera file instead of believing them.
    """
    return Registration(_polynomial((-_ADDED_PX, -_ADDED_PX), 0.0), float(1 << 20))


FACTORY = _factory()
IDENTITY = _identity()
