"""A sensor's timing with standard deviations: told, measured, and in its camera file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.calibration import (
    KINECT_READOUT_S,
    KINECT_TIMING_PRIOR,
    UNKNOWN_TIMING_SIGMAS_S,
    CameraCalibration,
    format_calibration,
    kinect_timing,
    read_calibration,
)
from drivers.camera import TimingPrior
from drivers.core import UserFacingError
from drivers.core.config import find_key_lines, parse_toml, read_toml_text
from vo_service.sensor_memory import RememberedSensor
from vo_service.tools.calibration.output_files import save_with_backup

# Two values contradict each other if they are further apart than this many standard deviations.
CONTRADICTION_SIGMAS = 3.0
# A measurement tells something if its standard deviations are below this part of unknown ones.
MAX_SIGMA_RATIO = 0.5
# Digits of saved seconds and of saved pixels, below the accuracy.
DIGITS = 5
FOCAL_DIGITS = 2
REMEDY = "shake the camera to and fro like a hand, for 15 s, near objects with texture and depth"


@dataclass(frozen=True)
class TimingValue:
    """A time and its standard deviation, s."""

    value_s: float
    sigma_s: float

    def __str__(self) -> str:
        return f"{1e3 * self.value_s:.1f} ± {1e3 * self.sigma_s:.1f} ms"

    def contradicts(self, other: "TimingValue") -> bool:
        """Whether both can hardly be the same time."""
        sigma_s = math.hypot(self.sigma_s, other.sigma_s)
        return abs(self.value_s - other.value_s) > CONTRADICTION_SIGMAS * sigma_s

    def combined_with(self, other: "TimingValue") -> "TimingValue":
        """Return the mean of two independent values, weighted by their information."""
        weight, other_weight = self.sigma_s**-2, other.sigma_s**-2
        total = weight + other_weight
        mean_s = (weight * self.value_s + other_weight * other.value_s) / total
        return TimingValue(mean_s, total**-0.5)


# By the key of the camera file: "readout_s" and "depth_offset_s".
SensorTiming = dict[str, TimingValue]


def make_timing(
    readout_s: float, depth_offset_s: float, readout_sigma_s: float, depth_offset_sigma_s: float
) -> SensorTiming:
    """Make a timing: readout of all rows, delay of depth after its stamps, standard deviations."""
    return {
        "readout_s": TimingValue(readout_s, readout_sigma_s),
        "depth_offset_s": TimingValue(depth_offset_s, depth_offset_sigma_s),
    }


def remembered_as_timing(remembered: RememberedSensor) -> SensorTiming:
    """Return what a service has learned."""
    return make_timing(
        remembered.readout_s,
        remembered.depth_offset_s,
        remembered.readout_sigma_s,
        remembered.depth_offset_sigma_s,
    )


def timing_by_prior(
    readout_s: float, depth_offset_s: float, prior: TimingPrior | None
) -> SensorTiming:
    """Return the timing of a prior; without one, both values are exact."""
    if prior is None:
        return make_timing(readout_s, depth_offset_s, 0.0, 0.0)
    return make_timing(
        readout_s, prior.depth_offset_s, prior.readout_sigma_s, prior.depth_offset_sigma_s
    )


USUAL_TIMING = timing_by_prior(KINECT_READOUT_S, 0.0, KINECT_TIMING_PRIOR)


def told_timing(camera: CameraCalibration, is_kinect: bool = False) -> SensorTiming:
    """Return what a camera file tells: a standard deviation of 0 is exact.

    Of a Kinect, the usual values hold if the file tells none.
    """
    of_file = camera.readout_s, camera.timing_prior
    readout_s, prior = kinect_timing(camera) if is_kinect else of_file
    return timing_by_prior(readout_s, camera.depth_offset_s, prior)


def combine(measured: SensorTiming, prior: SensorTiming) -> SensorTiming:
    """Combine a measurement with a prior."""
    return {key: value.combined_with(prior[key]) for key, value in measured.items()}


def improve_timing(told: SensorTiming, measured: SensorTiming, is_kinect: bool) -> SensorTiming:
    """Return the values that a measurement changes; that of a Kinect is combined with the usual.

    Raises:
        UserFacingError: The measurement is less certain than what is told.
    """
    changes = select_changes(told, combine(measured, USUAL_TIMING) if is_kinect else measured)
    if _is_informative(measured) and changes:
        return changes
    values = (
        f"{name} {measured[key]} (known: {told[key]})"
        for name, key in (("readout", "readout_s"), ("depth offset", "depth_offset_s"))
    )
    raise UserFacingError(
        "nothing is saved: the camera moved too slowly or too little to determine its timing "
        f"better than it is known: {', '.join(values)}; {REMEDY}"
    )


def _is_informative(measured: SensorTiming) -> bool:
    """Whether the motion was fast enough to tell anything."""
    sigmas_s = [value.sigma_s for value in measured.values()]
    limits_s = [MAX_SIGMA_RATIO * sigma_s for sigma_s in UNKNOWN_TIMING_SIGMAS_S]
    return all(sigma_s <= limit_s for sigma_s, limit_s in zip(sigmas_s, limits_s, strict=True))


def select_changes(told: SensorTiming, now: SensorTiming) -> SensorTiming:
    """Return the values that are at least as certain as what is told, or contradict it."""
    return {
        key: _rounded(key, value)
        for key, value in now.items()
        if value.sigma_s <= told[key].sigma_s or value.contradicts(told[key])
    }


def _rounded(key: str, value: TimingValue) -> TimingValue:
    value_s = max(value.value_s, 0.0) if key == "readout_s" else value.value_s
    return TimingValue(round(value_s, DIGITS), round(value.sigma_s, DIGITS))


def read_camera(path: Path, fallback: CameraCalibration) -> CameraCalibration:
    """Read a camera file; return `fallback` if it does not exist.

    Raises:
        InputError: The file is invalid.
    """
    return read_calibration(path) if path.exists() else fallback


def save_timing(
    path: Path,
    fallback: CameraCalibration,
    changes: SensorTiming,
    heading: str,
    focal_scale: float = 1.0,
) -> Path | None:
    """Change the timing in a camera file, or write a new file.

    Args:
        fallback: Contents of a new file, except for the timing.
        changes: The values to change, with their standard deviations.
        heading: Comment at the top of a new file.
        focal_scale: Factor on fx and fy.

    Returns:
        The path of the backup of an existing file; None without one.

    Raises:
        InputError: The existing file is not a camera file.
        UserFacingError: The disk fails; the existing file is then unchanged.
    """
    before = (
        read_toml_text(path) if path.exists() else f"# {heading}\n{format_calibration(fallback)}"
    )
    camera = parse_toml(before, str(path), CameraCalibration)
    values = file_values(changes)
    if focal_scale != 1.0:
        values |= {
            "fx": round(focal_scale * camera.fx, FOCAL_DIGITS),
            "fy": round(focal_scale * camera.fy, FOCAL_DIGITS),
        }
    text = replace_values(before, values)
    parse_toml(text, str(path), CameraCalibration)
    return save_with_backup(path, text.encode())


def replace_values(text: str, values: Mapping[str, float]) -> str:
    """Return a camera file's text with these keys changed, or inserted after `schema`."""
    for key, value in reversed(list(values.items())):
        lines, numbers = text.split("\n"), find_key_lines(text)
        if (key,) in numbers:
            index = numbers[(key,)] - 1
            _, comment_sign, comment = lines[index].partition("#")
            lines[index] = f"{key} = {value!r}" + (
                f"  {comment_sign}{comment}" if comment_sign else ""
            )
        else:
            lines.insert(numbers[("schema",)], f"{key} = {value!r}")
        text = "\n".join(lines)
    return text


def file_values(changes: SensorTiming) -> dict[str, float]:
    """Return the values by key of the camera file, each followed by its standard deviation."""
    values: dict[str, float] = {}
    for key, value in changes.items():
        values[key] = value.value_s
        values[f"{key.removesuffix('_s')}_sigma_s"] = value.sigma_s
    return values
