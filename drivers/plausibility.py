"""Whether intrinsics, depth and stamps can be those of an RGB-D camera: units, readings, steps.

It finds what is wrong by a factor: millimeters for meters or pixels, and marks for no reading. It
cannot find a near-range or time-of-flight sensor in a wrong unit, whose depth is that of another
scene: docs/reference/files.md has the list.
"""

import logging
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array

_log = logging.getLogger(__name__)

# Across the longer side of the image.
MIN_FIELD_OF_VIEW_DEG, MAX_FIELD_OF_VIEW_DEG = 20.0, 120.0
# A Kinect's focal length relative to the width of the image.
USUAL_FOCAL_LENGTH = 525.0 / 640.0
# The principal point lies this far inside the image, as a fraction of its size, or the intrinsics
# are refused; a crop of an image may have it far from the center, which is a warning.
MIN_CENTER_MARGIN, USUAL_CENTER_MARGIN = 0.05, 0.25


def find_intrinsics_error(camera: PinholeCamera) -> tuple[str, str] | None:
    """Return the field of impossible intrinsics and the reason; None if they are possible."""
    size_px = max(camera.width, camera.height)
    for key, focal_px in (("fx", camera.fx), ("fy", camera.fy)):
        angle_deg = 2.0 * math.degrees(math.atan2(size_px / 2.0, focal_px))
        if not MIN_FIELD_OF_VIEW_DEG <= angle_deg <= MAX_FIELD_OF_VIEW_DEG:
            return key, (
                f"{focal_px:g} pixels is a field of view of {angle_deg:.0f} degrees; give it in "
                f"pixels of these images, about {USUAL_FOCAL_LENGTH * size_px:.0f} for a Kinect"
            )
    for key, center_px, side_px in _principal_point(camera):
        if not _margin(center_px, side_px) >= MIN_CENTER_MARGIN:  # also NaN
            return key, (
                f"{center_px:g} is not well inside the image; give it in pixels of these images, "
                f"about {side_px / 2:.0f} of {side_px}"
            )
    return None


def _principal_point(camera: PinholeCamera) -> tuple[tuple[str, float, int], ...]:
    return ("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)


def _margin(center_px: float, side_px: int) -> float:
    """Return the distance to the nearer edge of the image, as a fraction of the side."""
    return min(center_px + 0.5, side_px - 0.5 - center_px) / side_px


def _find_intrinsics_fault(camera: PinholeCamera) -> str:
    if (error := find_intrinsics_error(camera)) is not None:
        return f"{error[0]} = {error[1]}"
    for key, center_px, side_px in _principal_point(camera):
        if _margin(center_px, side_px) < USUAL_CENTER_MARGIN:
            return (
                f"{key} = {center_px:g} is far from the center of the image; usual are about "
                f"{side_px / 2:.0f}, unless the images are a crop"
            )
    return ""


# Median depth of rooms. Sensors for the near range store millimeters or less; 5000 is the unit of
# the TUM benchmark, whose Kinects measure from 0.4 m.
MIN_MEDIAN_M, MIN_KINECT_MEDIAN_M, MAX_MEDIAN_M = 0.15, 0.5, 5.0
USUAL_MEDIAN_M = 1.7
MILLIMETERS, TUM_UNIT = 1000.0, 5000.0
# No Kinect measures farther.
MAX_RANGE_M, MAX_FAR_FRACTION = 10.0, 0.2
# A Kinect's distances are multiples of 1/8 pixel of disparity: neighbors differ by this fraction of
# the squared distance, 1 / (8 * 580 px * 0.075 m).
KINECT_STEP_PER_M = 0.00287
# Between the units above is a factor of 5; a sensor of half the resolution has twice the step.
MAX_STEP_RATIO = 3.0
# A step is measured over this many values, because the stored ones are rounded.
STEP_VALUES, MIN_STEPS = 8, 20
DepthHistogram = NDArray[np.int64]


def measure_depth_step(histogram: DepthHistogram, depth_factor: float) -> float | None:
    """Measure the steps of a sensor that triangulates: 1/m, their ratio to the squared distance.

    Args:
        histogram: (65536,) number of readings with each stored value.
        depth_factor: Stored value of one meter.

    Returns:
        None if the steps do not grow with the squared distance, or are lost in the rounding.
    """
    values = np.flatnonzero(histogram[1:]) + 1.0
    steps = (values[STEP_VALUES:] - values[:-STEP_VALUES]) / STEP_VALUES
    if len(steps) < MIN_STEPS:
        return None
    ratios = steps / (values[STEP_VALUES:] * values[:-STEP_VALUES])
    step_spread, ratio_spread = np.std(np.log(steps)), np.std(np.log(ratios))
    if np.median(steps) < 2.0 or ratio_spread > 0.5 * step_spread:
        return None
    return float(depth_factor * np.median(ratios))


def find_unit_fault(histogram: DepthHistogram, depth_factor: float) -> str:
    """Return why a depth factor is implausible, and the one that is plausible; "" if it is fine.

    A Kinect's steps tell the unit whatever it sees; without them the median decides.
    Arguments as for `measure_depth_step`.
    """
    median = 1 + int(np.searchsorted(np.cumsum(histogram[1:]), histogram[1:].sum() / 2))
    median_m = median / depth_factor
    step_per_m = measure_depth_step(histogram, depth_factor)
    ratio = (step_per_m or 0.0) / KINECT_STEP_PER_M
    is_far = median_m > MAX_MEDIAN_M
    is_near = median_m < MIN_MEDIAN_M
    if ratio:
        # Other stereo cameras have finer steps, but none has coarser ones.
        is_far, is_near = is_far and ratio < 1.0 / MAX_STEP_RATIO, ratio > MAX_STEP_RATIO
    elif 0.8 < depth_factor / TUM_UNIT < 1.25:
        is_near = median_m < MIN_KINECT_MEDIAN_M
    if not (is_far or is_near):
        return ""
    target = depth_factor / ratio if ratio else median / USUAL_MEDIAN_M
    candidates = [
        each
        for each in (MILLIMETERS, TUM_UNIT)
        if each != depth_factor and MIN_MEDIAN_M <= median / each <= MAX_MEDIAN_M
    ]
    unusual = float(f"{target:.1g}")
    plausible = min(candidates, key=lambda each: abs(math.log(each / target)), default=unusual)
    steps = f" and steps {ratio:.1f} times those of a Kinect" if ratio else ""
    return (
        f"a median depth of {median_m:.2g} m{steps}; depth_factor = {plausible:g} in a camera file "
        f"would give {median / plausible:.2g} m"
    )


def _find_range_fault(histogram: DepthHistogram, depth_factor: float) -> str:
    """Return what is stored for no reading if many readings are too far; "" if few are."""
    far = histogram.copy()
    far[: math.ceil(min(MAX_RANGE_M * depth_factor, len(far)))] = 0
    fraction = far.sum() / histogram[1:].sum()
    if fraction <= MAX_FAR_FRACTION:
        return ""
    return (
        f"{fraction:.0%} of the depth is beyond {MAX_RANGE_M:g} m, most often the value "
        f"{np.argmax(far)}; store 0 where there is no reading, or give the unit as depth_factor "
        "in a camera file"
    )


# Of a recording, the median; hand-held cameras see another place after a second.
MAX_FRAME_PERIOD_S = 5.0
SMALL_UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))


def find_stamp_fault(stamps_s: Array) -> str:
    """Return why the unit of a recording's (N,) stamps is implausible; "" if it is fine."""
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 2 else 0.0
    if period_s <= MAX_FRAME_PERIOD_S:
        return ""
    name, per_s = next(
        (u for u in SMALL_UNITS if period_s / u[1] < MAX_FRAME_PERIOD_S), SMALL_UNITS[-1]
    )
    return (
        f"the frames are {period_s:.0f} s apart; if the stamps are not in seconds but in {name}, "
        f"divide them by {per_s:.0f}"
    )


class FrameOrigin(Protocol):
    """A camera or a recording, for messages."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def intrinsics_source(self) -> str:
        """Where the intrinsics come from."""
        ...

    @property
    def depth_unit_source(self) -> str:
        """Where the depth factor comes from; "" if the unit is certain."""
        ...


# One frame a second is examined, for the first seconds; frames with hardly a reading do not count.
EXAMINED_PERIOD_FRAMES, MAX_EXAMINED_FRAMES = 30, 10
MIN_READINGS_FRACTION = 0.01


class PlausibilityCheck:
    """Examines some of a camera's first frames, and logs once what is implausible.

    Args:
        origin: The camera or recording.

    Attributes:
        warning: What is implausible, and the plausible value; "" = nothing.
    """

    def __init__(self, origin: FrameOrigin) -> None:
        self._origin = origin
        self._seen = self._examined = 0
        self._histogram: DepthHistogram = np.zeros(1 << 16, np.int64)
        self.warning = ""

    def add(self, frame: RgbdFrame) -> None:
        """Take the next frame; most are not examined."""
        if self._seen % EXAMINED_PERIOD_FRAMES == 0 and self._examined < MAX_EXAMINED_FRAMES:
            self.examine(frame)
        self._seen += 1

    def examine(self, frame: RgbdFrame) -> None:
        """Examine a frame; once there is a warning, do nothing."""
        if self.warning:
            return
        faults = [self._find_intrinsics_fault(frame.camera), self._find_depth_fault(frame)]
        self.warning = "; ".join(filter(None, faults))
        if self.warning:
            self.warning = f"{self._origin.name}: {self.warning}"
            _log.warning("%s", self.warning)

    def _find_intrinsics_fault(self, camera: PinholeCamera) -> str:
        fault = _find_intrinsics_fault(camera)
        source = self._origin.intrinsics_source
        return f"{source}: {fault}" if fault and source else fault

    def _find_depth_fault(self, frame: RgbdFrame) -> str:
        added = np.bincount(frame.depth_raw.ravel(), minlength=1 << 16)
        if added[1:].sum() < MIN_READINGS_FRACTION * frame.depth_raw.size:
            return ""
        self._examined += 1
        self._histogram += added
        source = self._origin.depth_unit_source
        fault = find_unit_fault(self._histogram, frame.depth_factor) if source else ""
        if fault:
            return f"depth_factor = {frame.depth_factor:g} ({source}) gives {fault}"
        return _find_range_fault(self._histogram, frame.depth_factor)
