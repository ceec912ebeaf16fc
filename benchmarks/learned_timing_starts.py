"""The learned timing of a recording that begins at a later frame."""

from dataclasses import asdict
from pathlib import Path

from benchmarks.accuracy import track_changed
from benchmarks.learned_timing_sensors import tell_exactly, tell_nothing, tell_zero
from benchmarks.result_cache import Json
from drivers.calibration import UNKNOWN_TIMING
from drivers.core.errors import InputError
from drivers.tum.folder import open_tum_folder

START_FRAMES = (0, 30, 60, 90, 120)
START_COLUMNS = ("recording, frame", "told", "ignored", "learned", "ratio", "failed", "timing, ms")
START_ROW = "| {:<20} | {:>6} | {:>7} | {:>7} | {:>5} | {:>9} | {:<28} |"
START_HEAD = START_ROW.format(*START_COLUMNS) + "\n|" + "---|" * len(START_COLUMNS)


def measure_start(method: str, recording: Path, first: int) -> Json:
    """Track a recording from a frame on: with its timing if it has one, with zeros, and learned.

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
    """One row of the table of starts."""
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
