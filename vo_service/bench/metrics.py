"""The columns of the bench: what is told of each run."""

from collections.abc import Callable, Mapping

import numpy as np

from drivers.geometry import Array
from vo_service.runs.judging import Judgement
from vo_service.runs.metric import Metric, corrected, evaluated, of_loops, of_run
from vo_service.runs.run import FrameLog

SPREAD: Mapping[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "median": lambda values: float(np.median(values)),
    "p95": lambda values: float(np.percentile(values, 95)),
    "p99": lambda values: float(np.percentile(values, 99)),
}


def _times(key: str, heading: str, of: Callable[[FrameLog], Array]) -> tuple[Metric, ...]:
    """How milliseconds a frame are spread; the first says what they are."""

    def metric(name: str, figure: Callable[[Array], float]) -> Metric:
        def value(judged: Judgement) -> float | None:
            times_ms = of(judged.outcome.run.frames)
            return figure(times_ms) if len(times_ms) else None

        return Metric(f"{key}_{name}", f"{heading} {name}" if name == "mean" else name, value, 1)

    return tuple(metric(name, figure) for name, figure in SPREAD.items())


ERRORS = (
    Metric("ate_rmse_m", "ATE mm", evaluated("ate_rmse_m"), 2, 1e3),
    Metric("mean_global_error_m", "global mm", evaluated("mean_global_error_m"), 2, 1e3),
    Metric("rpe_frame_m", "RPE mm", evaluated("rpe_frame_m"), 2, 1e3),
    Metric("rpe_frame_deg", "RPE °", evaluated("rpe_frame_deg"), 3),
    Metric("rpe_1s_m", "RPE 1 s mm", evaluated("rpe_1s_m"), 2, 1e3),
    Metric("rpe_1s_deg", "RPE 1 s °", evaluated("rpe_1s_deg"), 3),
)
HONESTY = (
    Metric("coverage", "cover %", lambda judged: judged.coverage, 1, 100.0),
    Metric("failed", "lost", of_run(lambda run: run.failed), 0),
    Metric("new_epochs", "epochs", of_run(lambda run: run.new_epochs), 0),
    Metric("gross_errors", "gross", lambda judged: judged.gross_errors, 0),
    Metric("steps", "of", lambda judged: judged.steps, 0),
)
CPU = _times("cpu_ms", "CPU ms", lambda frames: frames.cpu_ms)
WALL = _times("wall_ms", "wall ms", lambda frames: frames.wall_ms)
MEMORY = Metric("memory_mb", "memory MB", of_run(lambda run: run.memory_mb), 0)
# Where loops were asked for, beside the others.
LOOPS = (
    Metric("corrected_ate_rmse_m", "corrected ATE mm", corrected("ate_rmse_m"), 2, 1e3),
    Metric(
        "corrected_mean_global_error_m", "corrected global mm",
        corrected("mean_global_error_m"), 2, 1e3,
    ),
    Metric("places", "places", of_loops(lambda loops: loops.places), 0),
    Metric("loops", "loops", of_loops(lambda loops: loops.loops), 0),
)  # fmt: skip
LOOPS_CPU = Metric("loops_ms_per_frame", "loops ms", of_loops(lambda loops: loops.cpu_ms), 2)

METRICS = (*ERRORS, *HONESTY, *CPU, *WALL, MEMORY)
# Those that say how good a method is by their size: these are divided by another method's.
COMPARED = (*ERRORS, *CPU, *WALL, MEMORY)


def ratio(metric: Metric, judged: Judgement, against: Judgement) -> float | None:
    """How many times the other's; None where it cannot be told."""
    mine, theirs = metric.value(judged), metric.value(against)
    return mine / theirs if mine is not None and theirs else None


def figures(judged: Judgement) -> dict[str, float | None]:
    """Every metric by its key."""
    return {metric.key: metric.value(judged) for metric in METRICS}


def ratios(judged: Judgement, against: Judgement) -> dict[str, float | None]:
    """Every ratio by its metric's key."""
    return {metric.key: ratio(metric, judged, against) for metric in COMPARED}
