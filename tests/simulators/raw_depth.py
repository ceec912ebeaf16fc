"""From raw 11-bit depth to millimetres and back, with a Kinect's constants, as libfreenect does."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

RAW_NO_READING = 2047  # the sensor's "no reading"
RAW_VALUE_COUNT = 2048
MAX_DEPTH_MM = 9999  # libfreenect passes no registered depth beyond
CONST_SHIFT = 200

# The sensor counts quarters of a pixel, from a zero that lies 200 and 3/8 pixels off.
_STEPS_PER_PIXEL = 4.0
_ZERO_STEP = _STEPS_PER_PIXEL * (CONST_SHIFT + 0.375)
# Where one step is 70 mm or more, a grid can no longer be told from a coarser one.
_FIT_MAX_DEPTH_MM = 5000
_FIT_MIN_FRACTION = 1e-5  # readings seen less often are the work of whoever resampled the image
# Kinects differ by a percent; a try is a tenth of a step apart from the next at half a metre.
_FIT_GRID = (0.98, 1.02, 401)

Depth = NDArray[np.uint16]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class RawDepthScale:
    """The constants of one Kinect that fix its readings; float32 as it sends them.

    emitter_cm    infrared projector to depth camera
    reference_cm  how far the plane was against which it was calibrated
    pixel_cm      what one of the depth sensor's 1280 columns covers on that plane

    A raw value r stands for K / (c - r) mm with K = 40 emitter reference / pixel and
    c = 4 emitter / pixel + 801.5: triangulation against a reference plane (K. Khoshelham and S. O.
    Elberink, Sensors 2012, eq. 4).
    """

    emitter_cm: float = 7.5
    reference_cm: float = 120.0
    pixel_cm: float = 0.1042

    @property
    def focal_px(self) -> float:
        """Focal length of the 640x480 depth image that the constants stand for."""
        return self.reference_cm / (2.0 * self.pixel_cm)


NOMINAL = RawDepthScale()


def raw_to_mm(raw: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """Millimetres that libfreenect makes of raw values; 0 where it would give no usable reading."""
    return _mm_table(scale)[raw]


def mm_to_raw(depth_mm: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """The raw values whose millimetres come nearest; NO_RAW for 0 and for what is out of range."""
    return _raw_table(scale)[depth_mm]


def quantize_mm(depth_mm: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """What is left of depth in millimetres after it went over the wire."""
    return raw_to_mm(mm_to_raw(depth_mm, scale), scale)


def fit_scale(depth_images_mm: Iterable[Depth]) -> RawDepthScale:
    """The scale of the Kinect that recorded these images.

    Each Kinect's readings lie on a grid of its own; played on another's, every reading would move
    by up to half a step, 36 mm at 5 m. Readings are K / (n + phase) mm for whole numbers n: their
    inverse is a straight line in n. Without readings it is NOMINAL.
    """
    counts = np.zeros(_FIT_MAX_DEPTH_MM, np.int64)
    for image in depth_images_mm:
        counts += np.bincount(image.ravel(), minlength=65536)[:_FIT_MAX_DEPTH_MM]
    counts[0] = 0
    mm = np.flatnonzero(counts > _FIT_MIN_FRACTION * counts.sum())
    if len(mm) < 2:
        return NOMINAL
    centres_mm = np.asarray(mm + 0.5, np.float64)  # what is cut off is half a millimetre
    k_mm, phase = _fit_inverse_line(centres_mm, counts[mm].astype(np.float64))
    nominal_c = _STEPS_PER_PIXEL * NOMINAL.emitter_cm / NOMINAL.pixel_cm + _ZERO_STEP
    c = round(nominal_c - phase) + phase
    emitter_cm = (c - _ZERO_STEP) / _STEPS_PER_PIXEL * NOMINAL.pixel_cm
    reference_cm = k_mm * NOMINAL.pixel_cm / (10.0 * _STEPS_PER_PIXEL * emitter_cm)
    return RawDepthScale(emitter_cm, reference_cm, NOMINAL.pixel_cm)


def _fit_inverse_line(mm: Numbers, weight: Numbers) -> tuple[float, float]:
    """K and phase of K / mm = n + phase, with the right whole n for each reading."""
    k_mm, phase = _find_period(mm, weight)
    n = np.round(k_mm / mm - phase)
    # An error of a millimetre weighs the same at any distance: d(1/mm) = -d(mm) / mm^2.
    rows = (np.sqrt(weight) * mm**2)[:, None] * np.column_stack([n, np.ones_like(n)])
    slope, offset = np.linalg.lstsq(rows, np.sqrt(weight) * mm, rcond=None)[0]
    return float(1.0 / slope), float(offset / slope)


def _find_period(mm: Numbers, weight: Numbers) -> tuple[float, float]:
    """The K near the nominal one with which all readings fall in step, and their phase."""
    nominal = NOMINAL.emitter_cm * NOMINAL.reference_cm / NOMINAL.pixel_cm
    k_mm = 10.0 * _STEPS_PER_PIXEL * nominal * np.linspace(*_FIT_GRID)
    beats = np.exp(2j * np.pi * k_mm[:, None] / mm) @ weight
    best = np.argmax(abs(beats))
    return float(k_mm[best]), float(np.angle(beats[best]) / (2.0 * np.pi))


@cache
def _mm_table(scale: RawDepthScale) -> Depth:
    emitter_cm, reference_cm, pixel_cm = (
        float(np.float32(value)) for value in (scale.emitter_cm, scale.reference_cm, scale.pixel_cm)
    )
    offset = (np.arange(RAW_VALUE_COUNT) - _ZERO_STEP) / _STEPS_PER_PIXEL * pixel_cm
    mm = 10.0 * (offset * reference_cm / (emitter_cm - offset) + reference_cm)
    usable = (mm > 0) & (mm <= MAX_DEPTH_MM) & (offset < emitter_cm)
    usable[RAW_NO_READING] = False
    return np.where(usable, mm, 0.0).astype(np.uint16)


@cache
def _raw_table(scale: RawDepthScale) -> Depth:
    mm_of_raw = _mm_table(scale)
    usable = np.flatnonzero(mm_of_raw)
    mm = mm_of_raw[usable].astype(np.float64)
    bounds = (mm[1:] + mm[:-1]) / 2.0
    values = np.arange(65536)
    table = usable[np.searchsorted(bounds, values)].astype(np.uint16)
    table[(values < mm[0]) | (values > mm[-1])] = RAW_NO_READING
    return table
