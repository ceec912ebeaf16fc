"""Errors of the direct odometry when nobody tells it the sensor's timing.

    python -m benchmarks learned_timing FOLDER [--seeds 301 302 ...] [--starts RECORDING ...]

Each seed is another room and another virtual Kinect: a readout of 0 to 33 ms, depth 10 ms before to
15 ms after color and registered up to 3 px off, motion blur of 4 to 20 ms, and another hunting of
the exposure. The frames are tracked once with the exact timing ("told") and once without any. A
last row has a global shutter in the first seed's room: its timing must stay exactly zero.

"settled" are the seconds until both errors stay within 2 ms and 1.5 ms; "3 sigma" the share of the
seconds after which both are within three published standard deviations; "failed" the frames without
a pose, told and untold. ATE RMSE is in millimeters. The goals are a median ratio of the ATE of at
most 1.5, no sequence with failed frames or a reset, and 95 % within three sigmas.

--starts prints the ATE of recordings that begin at later frames: with the recording's own timing
("told"), with zeros ("ignored") and learned. --seeds without numbers skips the virtual Kinects.

FOLDER stores the rendered sequences, 0.5 GB each, and the results in results.json. The same command
continues after an interruption. Remove results.json when the odometry has changed.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Json, ResultCache
from benchmarks.rendered_sequences import render_all
from benchmarks.tracking import Accuracy, TrackedSequence, track_changed
from drivers.calibration import UNKNOWN_TIMING
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array
from drivers.synthetic import ShutterTiming, SyntheticConfig
from drivers.tum import open_tum_folder
from vo_service.odometry import warm_up
from vo_service.types import OnlineTiming

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


# Errors of readout and delay from which on the timing counts as learned.
LEARNED_ERRORS_S = (0.002, 0.0015)
CONSISTENT_SIGMAS = 3.0
METHOD = "direct"
# Rooms that no parameter was chosen with.
SEEDS = tuple(range(301, 321))
DURATION_S = 20.0
TIMING_COLUMNS = ("readout", "learned", "delay", "learned", "settled s", "3 sigma")
COLUMNS = ("seed", *TIMING_COLUMNS, "told", "untold", "ratio", "failed", "resets")
TIMING_ROW = "{:>7} | {:>12} | {:>7} | {:>12} | {:>9} | {:>7}"
ROW = f"| {{:<14}} | {TIMING_ROW} | {{:>6}} | {{:>6}} | {{:>5}} | {{:>7}} | {{:>6}} |"
SEPARATOR = "|" + "---|" * len(COLUMNS)


@dataclass(frozen=True)
class LearnedTiming:
    """Result of one recording.

    Attributes:
        told: Accuracy with the exact timing.
        untold: Accuracy with no timing told.
        truth_s: True readout and delay.
        learned_s: Both after the last frame.
        sigmas_s: Their published standard deviations.
        settling_s: Time from the first frame until both errors stay within `LEARNED_ERRORS_S`;
            None if they do not.
        seconds: Number of seconds, after each of which the timing was compared with the truth.
        consistent: Those in which both errors are within `CONSISTENT_SIGMAS`.
        nonzero: Frames with a readout or a delay other than exactly zero.
    """

    told: Accuracy
    untold: Accuracy
    truth_s: tuple[float, float]
    learned_s: tuple[float, float]
    sigmas_s: tuple[float, float]
    settling_s: float | None
    seconds: int
    consistent: int
    nonzero: int


def evaluate_timing(
    told: Accuracy, untold: Accuracy, tracked: TrackedSequence, truth_s: tuple[float, float]
) -> LearnedTiming:
    """Compare the timing that was published with each frame with the truth.

    Args:
        told: Accuracy with the exact timing.
        untold: Accuracy of `tracked`.
        tracked: Estimates with a timing, of at least one frame.
        truth_s: True readout and delay.
    """
    timings = [estimate.timing for estimate in tracked.estimates]
    published = np.array([_as_row(timing) for timing in timings if timing is not None])
    errors_s, sigmas_s = np.abs(published[:, :2] - truth_s), published[:, 2:]
    times_s = tracked.stamps_s - tracked.stamps_s[0]
    is_consistent = np.all(errors_s <= CONSISTENT_SIGMAS * sigmas_s, axis=1)[_second_ends(times_s)]
    return LearnedTiming(
        told=told,
        untold=untold,
        truth_s=truth_s,
        learned_s=(published[-1, 0], published[-1, 1]),
        sigmas_s=(published[-1, 2], published[-1, 3]),
        settling_s=_settling_time_s(times_s, errors_s),
        seconds=len(is_consistent),
        consistent=int(is_consistent.sum()),
        nonzero=int(np.count_nonzero(np.any(published[:, :2] != 0.0, axis=1))),
    )


def _as_row(timing: OnlineTiming) -> tuple[float, float, float, float]:
    return (
        timing.readout_s,
        timing.depth_offset_s,
        timing.readout_sigma_s,
        timing.depth_offset_sigma_s,
    )


def _second_ends(times_s: Array) -> NDArray[np.int64]:
    """The last frame of each second that has frames."""
    seconds = np.floor(times_s + 1e-6)
    return np.flatnonzero(np.append(np.diff(seconds) > 0, True))


def _settling_time_s(times_s: Array, errors_s: Array) -> float | None:
    """Time of the first frame from which on all errors are within `LEARNED_ERRORS_S`."""
    wrong = np.flatnonzero((errors_s > LEARNED_ERRORS_S).any(axis=1))
    if not len(wrong):
        return 0.0
    return float(times_s[wrong[-1] + 1]) if wrong[-1] + 1 < len(times_s) else None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path, help="folder of the sequences and the results")
    parser.add_argument("--seeds", nargs="*", type=int, default=SEEDS)
    parser.add_argument("--seconds", type=float, default=DURATION_S, help="length of a sequence")
    parser.add_argument("--starts", nargs="+", type=Path, default=[], metavar="RECORDING")
    parser.add_argument("--at", nargs="+", type=int, default=START_FRAMES, metavar="FRAME")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)


def main(args: argparse.Namespace) -> None:
    """Render and run what has no stored result, and print all."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(args.folder)
    warm_up(METHOD, lambda stage: None)
    if args.seeds:
        _print_seeds(cache, args.folder, make_sensors(args.seeds, args.seconds), args.processes)
    _print_starts(cache, args.starts, args.at)


def make_sensors(seeds: Sequence[int], duration_s: float) -> dict[str, RandomSensor]:
    """Make the sensors of the seeds by name; the last one has a global shutter."""
    sensors = {f"{seed}-{duration_s:g}s": make_random_sensor(seed, duration_s) for seed in seeds}
    sensors[f"{seeds[0]}-{duration_s:g}s-global"] = make_random_sensor(
        seeds[0], duration_s, is_global_shutter=True
    )
    return sensors


def _print_seeds(
    cache: ResultCache, folder: Path, sensors: Mapping[str, RandomSensor], processes: int
) -> None:
    """Render and measure what has no result; print a row for each sensor and the summary."""
    missing = {
        folder / name: sensor.config for name, sensor in sensors.items() if name not in cache
    }
    render_all(missing, lambda line: print(line, file=sys.stderr, flush=True), processes)
    print(f"{ROW.format(*COLUMNS)}\n{SEPARATOR}", flush=True)
    results = []
    for name, sensor in sensors.items():
        results.append(cache.get_or_run(name, partial(measure_sensor, folder / name, sensor)))
        print(format_row(name, results[-1]), flush=True)
    print(f"\n{format_summary(results[:-1])}\n{format_global_shutter(results[-1])}", flush=True)


def measure_sensor(folder: Path, sensor: RandomSensor) -> Json:
    """Track the frames of a sensor, told and untold."""
    timing = sensor.config.timing
    _, told = track_changed(METHOD, folder, lambda frame: tell_exactly(sensor.shift_depth(frame)))
    tracked, untold = track_changed(
        METHOD, folder, lambda frame: tell_nothing(sensor.shift_depth(frame))
    )
    return asdict(evaluate_timing(told, untold, tracked, (timing.readout_s, timing.skew_s)))


def format_row(name: str, result: Json) -> str:
    """One row of the table of sensors."""
    told, untold = result["told"], result["untold"]
    cells: list[str] = []
    for truth_s, learned_s, sigma_s in zip(
        result["truth_s"], result["learned_s"], result["sigmas_s"], strict=True
    ):
        cells += [f"{1e3 * truth_s:.1f}", f"{1e3 * learned_s:.1f} ± {1e3 * sigma_s:.1f}"]
    settling_s = result["settling_s"]
    return ROW.format(
        name,
        *cells,
        "never" if settling_s is None else f"{settling_s:.1f}",
        f"{100 * result['consistent'] / result['seconds']:.0f} %",
        *(_format_mm(run["ate_m"]) for run in (told, untold)),
        f"{ate_ratio(result):.2f}",
        f"{told['failed']}, {untold['failed']}",
        untold["resets"],
    )


def format_summary(results: Sequence[Json]) -> str:
    """The figures that have goals, over all sensors."""
    lost = sum(result["untold"]["failed"] + result["untold"]["resets"] > 0 for result in results)
    seconds = sum(result["seconds"] for result in results)
    consistent = sum(result["consistent"] for result in results)
    settled = sum(result["settling_s"] is not None for result in results)
    return (
        f"{len(results)} seeds: median ATE ratio {np.median([ate_ratio(r) for r in results]):.2f} "
        f"(goal 1.5), with failed frames or a reset {lost} (goal 0), "
        f"within 3 sigmas {100 * consistent / seconds:.1f} % (goal 95 %), settled {settled}"
    )


def format_global_shutter(result: Json) -> str:
    """Whether the timing of a global shutter stayed zero."""
    return f"global shutter: {result['nonzero']} frames with a timing other than zero (goal 0)"


def ate_ratio(result: Json) -> float:
    """ATE untold by that told; infinite if there is none untold, and NaN without any."""
    told_m, untold_m = result["told"]["ate_m"], result["untold"]["ate_m"]
    if untold_m is None:
        return float("inf")
    return float("nan") if not told_m else float(untold_m / told_m)


def _print_starts(cache: ResultCache, recordings: Sequence[Path], frames: Sequence[int]) -> None:
    """Print a row for each recording and each first frame."""
    if recordings:
        print(f"\n{START_HEAD}")
    for recording in recordings:
        for first in frames:
            name = f"{recording.resolve()} from {first}"
            result = cache.get_or_run(name, partial(measure_start, METHOD, recording, first))
            print(format_start(recording.name, first, result), flush=True)


def _format_mm(value_m: float | None) -> str:
    return "-" if value_m is None else f"{1e3 * value_m:.1f}"
