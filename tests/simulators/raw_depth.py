"""Convert raw 11-bit depth to millimeters and back, with a Kinect's constants, like libfreenect."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

RAW_NO_READING = 2047  # the sensor's "no reading"
RAW_VALUE_COUNT = 2048
MAX_DEPTH_MM = 9999  # libfreenect delivers no registered depth beyond
CONST_SHIFT = 200

# The sensor counts quarters of a pixel, from an offset of 200 3/8 pixels.
_STEPS_PER_PIXEL = 4.0
_ZERO_STEP = _STEPS_PER_PIXEL * (CONST_SHIFT + 0.375)
# Where a step is 70 mm or more, a grid cannot be distinguished from a coarser one.
_FIT_MAX_DEPTH_MM = 5000
_FIT_MIN_FRACTION = 1e-5  # rarer readings come from resampling of the image
# Kinects differ by a percent; candidates differ by a tenth of a step at half a meter.
_FIT_GRID = (0.98, 1.02, 401)

Depth = NDArray[np.uint16]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class RawDepthScale:
    """The constants of one Kinect that determine its readings; sent as float32.

    A raw value r means K / (c - r) mm with K = 40 emitter reference / pixel and
    c = 4 emitter / pixel + 801.5: triangulation against a reference plane (K. Khoshelham and S. O.
    Elberink, Sensors 2012, eq. 4).

    Attributes:
        emitter_cm: Distance from the infrared projector to the depth camera.
        reference_cm: Distance of the calibration plane.
        pixel_cm: Size on that plane of one of the depth sensor's 1280 columns.
    """

    emitter_cm: float = 7.5
    reference_cm: float = 120.0
    pixel_cm: float = 0.1042

    @property
    def focal_px(self) -> float:
        """Focal length of the 640x480 depth image."""
        return self.reference_cm / (2.0 * self.pixel_cm)


NOMINAL = RawDepthScale()


def raw_to_mm(raw: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """Convert raw values to libfreenect's millimeters; 0 where there is no usable reading."""
    return _mm_table(scale)[raw]


def mm_to_raw(depth_mm: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """Convert to the nearest raw values; RAW_NO_READING for 0 and for depth out of range."""
    return _raw_table(scale)[depth_mm]


def quantize_mm(depth_mm: Depth, scale: RawDepthScale = NOMINAL) -> Depth:
    """Quantize depth in millimeters as the transfer in raw values does."""
    return raw_to_mm(mm_to_raw(depth_mm, scale), scale)


def fit_scale(depth_images_mm: Iterable[Depth]) -> RawDepthScale:
    """Estimate the scale of the Kinect that recorded these images.

    Each Kinect's readings lie on its own grid; on another grid every reading would move by up to
    half a step, 36 mm at 5 m. Readings are K / (n + phase) mm for integers n, so their inverse is a
    straight line in n. Without readings the scale is NOMINAL.
    """
    counts = np.zeros(_FIT_MAX_DEPTH_MM, np.int64)
    for image in depth_images_mm:
        counts += np.bincount(image.ravel(), minlength=65536)[:_FIT_MAX_DEPTH_MM]
    counts[0] = 0
    mm = np.flatnonzero(counts > _FIT_MIN_FRACTION * counts.sum())
    if len(mm) < 2:
        return NOMINAL
    centers_mm = np.asarray(mm + 0.5, np.float64)  # truncation removes half a millimeter
    k_mm, phase = _fit_inverse_line(centers_mm, counts[mm].astype(np.float64))
    nominal_c = _STEPS_PER_PIXEL * NOMINAL.emitter_cm / NOMINAL.pixel_cm + _ZERO_STEP
    c = round(nominal_c - phase) + phase
    emitter_cm = (c - _ZERO_STEP) / _STEPS_PER_PIXEL * NOMINAL.pixel_cm
    reference_cm = k_mm * NOMINAL.pixel_cm / (10.0 * _STEPS_PER_PIXEL * emitter_cm)
    return RawDepthScale(emitter_cm, reference_cm, NOMINAL.pixel_cm)


def _fit_inverse_line(mm: Numbers, weight: Numbers) -> tuple[float, float]:
    """Fit K and phase of K / mm = n + phase, with an integer n for each reading."""
    k_mm, phase = _find_period(mm, weight)
    n = np.round(k_mm / mm - phase)
    # An error of a millimeter has the same weight at any distance: d(1/mm) = -d(mm) / mm^2.
    rows = (np.sqrt(weight) * mm**2)[:, None] * np.column_stack([n, np.ones_like(n)])
    slope, offset = np.linalg.lstsq(rows, np.sqrt(weight) * mm, rcond=None)[0]
    return float(1.0 / slope), float(offset / slope)


def _find_period(mm: Numbers, weight: Numbers) -> tuple[float, float]:
    """Find the K near the nominal one that gives all readings the same phase, and that phase."""
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
