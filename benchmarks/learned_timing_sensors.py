"""Random sensors for the learned timing, and recordings that begin at a later frame."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import Json
from benchmarks.tracking import track_changed
from drivers.calibration import UNKNOWN_TIMING
from drivers.camera import RgbdFrame
from drivers.core.errors import InputError
from drivers.synthetic import ShutterTiming, SyntheticConfig
from drivers.tum import open_tum_folder

MAX_READOUT_S = 0.033
DELAYS_S = (-0.010, 0.015)
EXPOSURES_S = (0.004, 0.020)
GAIN_DRIFTS = (0.05, 0.25)
MAX_REGISTRATION_ERROR_PX = 3.0
START_FRAMES = (0, 30, 60, 90, 120)
START_COLUMNS = ("recording, frame", "told", "ignored", "learned", "ratio", "failed", "timing, ms")
START_ROW = "| {:<20} | {:>6} | {:>7} | {:>7} | {:>5} | {:>9} | {:<28} |"
START_HEAD = START_ROW.format(*START_COLUMNS) + "\n|" + "---|" * len(START_COLUMNS)


@dataclass(frozen=True)
class RandomSensor:
    """A virtual Kinect and the error of its depth's registration.

    Attributes:
        config: Room, motion, timing and exposure.
        shift_px: Columns and rows by which depth is registered too far right and down.
    """

    config: SyntheticConfig
    shift_px: tuple[int, int]

    def shift_depth(self, frame: RgbdFrame) -> RgbdFrame:
        """Register the depth of a frame with the error; there are no readings beyond the border."""
        T = np.array([[1.0, 0.0, self.shift_px[0]], [0.0, 1.0, self.shift_px[1]]])
        height, width = frame.depth_raw.shape
        depth = cv2.warpAffine(frame.depth_raw, T, (width, height), flags=cv2.INTER_NEAREST)
        return replace(frame, depth_raw=np.asarray(depth, np.uint16))


def make_random_sensor(
    seed: int, duration_s: float, is_global_shutter: bool = False
) -> RandomSensor:
    """Draw the sensor of a seed, which is also that of the room and of the motion.

    Args:
        seed: The seed.
        duration_s: Length of the sequence, s.
        is_global_shutter: Whether all rows are exposed at once.

    Raises:
        InputError: The seed is negative, or the duration is shorter than a frame.
    """
    base = SyntheticConfig(seed=seed, duration_s=duration_s)
    rng = np.random.default_rng([seed, 33])
    timing = ShutterTiming(
        round(rng.uniform(0.0, MAX_READOUT_S), 6), round(rng.uniform(*DELAYS_S), 6)
    )
    color = replace(
        base.color,
        exposure_s=round(rng.uniform(*EXPOSURES_S), 6),
        gain_drift=round(rng.uniform(*GAIN_DRIFTS), 3),
    )
    distance_px = MAX_REGISTRATION_ERROR_PX * np.sqrt(rng.uniform())
    angle_rad = rng.uniform(0.0, 2.0 * np.pi)
    shift_px = (round(distance_px * np.cos(angle_rad)), round(distance_px * np.sin(angle_rad)))
    if is_global_shutter:
        timing = ShutterTiming(0.0, 0.0)
    return RandomSensor(replace(base, color=color, timing=timing), shift_px)


def tell_nothing(frame: RgbdFrame) -> RgbdFrame:
    """Make a frame as of a recording whose camera file and stamps have no timing."""
    return replace(frame, readout_s=0.0, skew_s=0.0, timing_prior=UNKNOWN_TIMING)


def tell_exactly(frame: RgbdFrame) -> RgbdFrame:
    """Make a frame whose timing is taken as exact."""
    return replace(frame, timing_prior=None)


def tell_zero(frame: RgbdFrame) -> RgbdFrame:
    """Make a frame as of a global shutter, so that nothing is learned."""
    return replace(frame, readout_s=0.0, skew_s=0.0, timing_prior=None)


def measure_start(method: str, recording: Path, first: int) -> Json:
    """Track a recording from a frame on: with its timing if it has one, with zeros, and learned.

    Args:
        method: The method.
        recording: Folder of the recording.
        first: First frame.

    Raises:
        InputError: The recording has no ground truth, or fewer frames.
    """
    opened = open_tum_folder(recording, None)
    count = len(opened.frames.pairs)
    if not 0 <= first < count:
        raise InputError(f"{recording}: has no frame {first}; begin at one of 0 to {count - 1}")
    has_timing = opened.calibration.timing_prior != UNKNOWN_TIMING
    told = track_changed(method, recording, tell_exactly, first)[1] if has_timing else None
    ignored = track_changed(method, recording, tell_zero, first)[1]
    tracked, learned = track_changed(method, recording, tell_nothing, first)
    timing = tracked.estimates[-1].timing
    return {
        "told": told and asdict(told),
        "ignored": asdict(ignored),
        "learned": asdict(learned),
        "timing": timing and asdict(timing),
    }


def format_start(recording: str, first: int, result: Json) -> str:
    """One row of the table of starts.

    Args:
        recording: Name of the recording.
        first: First frame.
        result: Result of `measure_start`.
    """
    runs = [result[key] for key in ("told", "ignored", "learned")]
    ate_m = [None if run is None else run["ate_m"] for run in runs]
    ratio = f"{ate_m[2] / ate_m[0]:.2f}" if ate_m[0] and ate_m[2] is not None else "-"
    failed = ", ".join("-" if run is None else str(run["failed"]) for run in runs)
    timing = result["timing"]
    pairs = [
        f"{1e3 * timing[f'{name}_s']:.1f} ± {1e3 * timing[f'{name}_sigma_s']:.1f}"
        for name in ("readout", "depth_offset")
    ]
    cells = ("-" if error_m is None else f"{1e3 * error_m:.1f}" for error_m in ate_m)
    return START_ROW.format(f"{recording}, {first}", *cells, ratio, failed, ", ".join(pairs))
