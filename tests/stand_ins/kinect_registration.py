"""The calibration that a played Kinect carries, and what libfreenect makes of it.

A Kinect keeps in its memory how its raw 11-bit depth becomes millimetres, and where a pixel of the
depth camera lies in the colour camera's image. libfreenect reads both when it opens the camera.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

NO_RAW = 2047  # the sensor's "no reading"
RAW_VALUES = 2048
MOST_MM = 9999  # libfreenect passes no registered depth beyond
CONST_SHIFT = 200

# What libfreenect always does between the camera's own numbers and a pixel: it adds one pixel and
# 3/8, and takes the two cameras to be 2.4 cm apart, whatever the Kinect says.
_ADDED_PX = 1.0
_ADDED_COLUMNS_PX = 0.375
_CAMERAS_APART_CM = 2.4

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
    """What the Kinect tells of its cameras; `polynomial` maps depth pixels to colour pixels."""

    polynomial: tuple[int, ...]
    emitter_cm: float
    colour_camera_cm: float
    reference_cm: float
    pixel_mm: float

    @property
    def zero_plane(self) -> tuple[float, float, float, float]:
        """As the camera sends it."""
        return self.emitter_cm, self.colour_camera_cm, self.reference_cm, self.pixel_mm

    @property
    def depth_focal_px(self) -> float:
        """Focal length of the 640x480 depth image that the constants stand for."""
        return 10.0 * self.reference_cm / (2.0 * 10.0 * self.pixel_mm)


def _polynomial(shift_px: tuple[float, float], slope: float) -> tuple[int, ...]:
    numbers = [0] * _NUMBERS
    numbers[_X_START] = round(shift_px[0] * _PER_PIXEL)
    numbers[_Y_START] = round(shift_px[1] * _PER_PIXEL)
    numbers[_X_SLOPE] = numbers[_Y_SLOPE] = round(slope * _PER_SLOPE)
    return tuple(numbers)


def _factory() -> Registration:
    """A Kinect as made: colour camera 2.4 cm beside the depth camera, with a wider view."""
    nominal = Registration((), 7.5, 2.3, 120.0, 0.1042)
    slope = _COLOUR_FOCAL_PX / nominal.depth_focal_px - 1.0
    # libfreenect shifts columns by this much at infinity, and by nothing at the reference distance.
    at_infinity_px = 10.0 * _CAMERAS_APART_CM / (2.0 * 10.0 * nominal.pixel_mm)
    x = -slope * _CENTRE_PX[0] - at_infinity_px - _ADDED_PX - _ADDED_COLUMNS_PX + 0.5
    y = -slope * _CENTRE_PX[1] - _ADDED_PX + 0.5
    return Registration(_polynomial((x, y), slope), *nominal.zero_plane)


def _identity() -> Registration:
    """Registering moves nothing, for depth that is registered already.

    libfreenect's shift by distance cannot be switched off, but it goes with 1 / pixel size, while
    millimetres depend only on pixel size / emitter distance: both times 2^20 leave the
    millimetres as they are, bit for bit, and make the shift a millionth. No real lens has such
    numbers: give a camera file instead of believing them.
    """
    factory = _factory()
    huge = float(1 << 20)
    moved = _polynomial((-_ADDED_PX, -_ADDED_PX), 0.0)
    return Registration(
        moved,
        factory.emitter_cm * huge,
        factory.colour_camera_cm,
        factory.reference_cm,
        factory.pixel_mm * huge,
    )


FACTORY = _factory()
IDENTITY = _identity()


def expected_mm(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Millimetres that libfreenect makes of raw values; 0 where it would give no usable reading.

    Triangulation against the reference plane (K. Khoshelham and S. O. Elberink, Sensors 2012, eq.
    4), in quarters of a pixel as the sensor counts. The same for FACTORY and IDENTITY.
    """
    return _mm_of_raw()[raw]


def raw_of_mm(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The raw values whose millimetres come nearest; NO_RAW for 0 and for what is out of range."""
    return _raw_of_mm()[depth_mm]


def quantised_mm(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """What is left of depth in millimetres after it went over the wire."""
    return expected_mm(raw_of_mm(depth_mm))


@cache
def _mm_of_raw() -> NDArray[np.uint16]:
    emitter_cm, _, reference_cm, pixel_mm = (float(np.float32(v)) for v in FACTORY.zero_plane)
    raw = np.arange(RAW_VALUES, dtype=np.float64)
    pixels = (raw - 4.0 * CONST_SHIFT) / 4.0 - 0.375
    offset = pixels * pixel_mm
    mm = 10.0 * (offset * reference_cm / (emitter_cm - offset) + reference_cm)
    usable = (mm > 0) & (mm <= MOST_MM) & (offset < emitter_cm)
    usable[NO_RAW] = False
    return np.where(usable, mm, 0.0).astype(np.uint16)


@cache
def _raw_of_mm() -> NDArray[np.uint16]:
    mm_of_raw = _mm_of_raw()
    usable = np.flatnonzero(mm_of_raw)
    mm = mm_of_raw[usable].astype(np.float64)
    bounds = (mm[1:] + mm[:-1]) / 2.0
    values = np.arange(65536)
    table = usable[np.searchsorted(bounds, values)].astype(np.uint16)
    table[(values < mm[0]) | (values > mm[-1])] = NO_RAW
    return table
