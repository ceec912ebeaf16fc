"""Report of the bench: its tables, all metrics for scripts, and the settings."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core.geometry import Array
from vo_service.config import OdometryConfig
from vo_service.tools.benchmark import FrameLog, collect_versions
from vo_service.tools.benchmark.baselines import BASELINE_NAMES, find_package
from vo_service.tools.benchmark.methods import UnavailableMethods
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.report import (
    MetricColumn,
    Table,
    TableCell,
    format_effective_config,
    from_evaluation,
    from_loop_closure,
    from_optimized_evaluation,
    from_run,
    number_cell,
    text_cell,
)
from vo_service.tools.benchmark.results import RunEvaluation, SequenceResults
from vo_service.tools.benchmark.run_cache import write_file

STATISTICS: Mapping[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "median": lambda values: float(np.median(values)),
    "p95": lambda values: float(np.percentile(values, 95)),
    "p99": lambda values: float(np.percentile(values, 99)),
}
# These columns show a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


def _time_metrics(
    key: str, heading: str, times_of: Callable[[FrameLog], Array]
) -> tuple[MetricColumn, ...]:
    """Return columns with statistics of the times per frame; the first heading names the time."""

    def metric(name: str, statistic: Callable[[Array], float]) -> MetricColumn:
        def value(evaluation: RunEvaluation) -> float | None:
            times_ms = times_of(evaluation.outcome.run.frames)
            return statistic(times_ms) if len(times_ms) else None

        return MetricColumn(
            f"{key}_{name}", f"{heading} {name}" if name == "mean" else name, value, 1
        )

    return tuple(metric(name, statistic) for name, statistic in STATISTICS.items())


ERROR_METRICS = (
    MetricColumn("ate_rmse_m", "ATE mm", from_evaluation("ate_rmse_m"), 2, 1e3),
    MetricColumn(
        "mean_global_error_m", "global mm", from_evaluation("mean_global_error_m"), 2, 1e3
    ),
    MetricColumn("rpe_frame_m", "RPE mm", from_evaluation("rpe_frame_m"), 2, 1e3),
    MetricColumn("rpe_frame_deg", "RPE °", from_evaluation("rpe_frame_deg"), 3),
    MetricColumn("rpe_1s_m", "RPE 1 s mm", from_evaluation("rpe_1s_m"), 2, 1e3),
    MetricColumn("rpe_1s_deg", "RPE 1 s °", from_evaluation("rpe_1s_deg"), 3),
)
ROBUSTNESS_METRICS = (
    MetricColumn("coverage", "coverage %", lambda evaluation: evaluation.coverage, 1, 100.0),
    MetricColumn("failed", "lost", from_run(lambda run: run.failed), 0),
    MetricColumn("new_epochs", "epochs", from_run(lambda run: run.new_epochs), 0),
    MetricColumn("gross_errors", "gross", lambda evaluation: evaluation.gross_errors, 0),
    MetricColumn("steps", "of", lambda evaluation: evaluation.steps, 0),
)
CPU_METRICS = _time_metrics("cpu_ms", "CPU ms", lambda frames: frames.cpu_ms)
WALL_METRICS = _time_metrics("wall_ms", "wall ms", lambda frames: frames.wall_ms)
MEMORY_METRIC = MetricColumn("memory_mb", "memory MB", from_run(lambda run: run.memory_mb), 0)
# Additional columns with loop closure.
LOOP_CLOSURE_METRICS = (
    MetricColumn(
        "optimized_ate_rmse_m", "optimized ATE mm",
        from_optimized_evaluation("ate_rmse_m"), 2, 1e3,
    ),
    MetricColumn(
        "optimized_mean_global_error_m", "optimized global mm",
        from_optimized_evaluation("mean_global_error_m"), 2, 1e3,
    ),
    MetricColumn("map_keyframes", "keyframes", from_loop_closure(lambda run: run.map_keyframes), 0),
    MetricColumn("loop_closures", "loops", from_loop_closure(lambda run: run.loop_closures), 0),
)  # fmt: skip
LOOP_CLOSURE_CPU_METRIC = MetricColumn(
    "loop_closure_ms_per_frame", "loops ms", from_loop_closure(lambda run: run.cpu_ms_per_frame), 2
)

ALL_METRICS = (*ERROR_METRICS, *ROBUSTNESS_METRICS, *CPU_METRICS, *WALL_METRICS, MEMORY_METRIC)
# Metrics whose ratio to the baseline method is meaningful.
RATIO_METRICS = (*ERROR_METRICS, *CPU_METRICS, *WALL_METRICS, MEMORY_METRIC)


def ratio(
    metric: MetricColumn, evaluation: RunEvaluation, reference: RunEvaluation
) -> float | None:
    """Return the ratio of a metric to that of the baseline method, or None if not known.

    Args:
        metric: The metric.
        evaluation: The run.
        reference: The run of the baseline method.
    """
    value, reference_value = metric.value(evaluation), metric.value(reference)
    return value / reference_value if value is not None and reference_value else None


def metric_values(evaluation: RunEvaluation) -> dict[str, float | None]:
    """Return every metric by its key."""
    return {metric.key: metric.value(evaluation) for metric in ALL_METRICS}


def metric_ratios(evaluation: RunEvaluation, reference: RunEvaluation) -> dict[str, float | None]:
    """Return every ratio by its metric's key."""
    return {metric.key: ratio(metric, evaluation, reference) for metric in RATIO_METRICS}


@dataclass(frozen=True)
class RelativeResults:
    """Results of one recording at one frame step, relative to a baseline method."""

    results: SequenceResults
    reference_method: str

    @property
    def reference_evaluation(self) -> RunEvaluation:
        """Evaluation of the baseline method."""
        return self.results.evaluations[self.reference_method]

    @property
    def title(self) -> str:
        """Recording and selected frames, as a heading."""
        recording = self.results.recording
        step = recording.frame_selection.step
        frames = f"{len(recording.frame_stamps_s)} frames in {recording.duration_s:.1f} s"
        used = "every frame" if step == 1 else f"1 frame in {step}"
        truth = (
            "" if recording.truth is not None else ", no groundtruth.txt, so errors are not known"
        )
        return f"{recording.folder.resolve().name}, {used}: {frames}{truth}"

    def error_table(self) -> Table:
        """Return the table of errors and lost frames."""
        title = f"{self.title}; in () relative to {self.reference_method}"
        loop_closure_metrics = LOOP_CLOSURE_METRICS if self.results.has_loop_closure else ()
        return self._table(title, (*ERROR_METRICS, *ROBUSTNESS_METRICS, *loop_closure_metrics))

    def cost_table(self) -> Table:
        """Return the table of times per frame and memory."""
        loop_closure_metrics = (LOOP_CLOSURE_CPU_METRIC,) if self.results.has_loop_closure else ()
        return self._table("", (*CPU_METRICS, *WALL_METRICS, MEMORY_METRIC, *loop_closure_metrics))

    def _table(self, title: str, metrics: Sequence[MetricColumn]) -> Table:
        rows = [
            [
                _name_cell(method, evaluation),
                *(self._cell(metric, evaluation) for metric in metrics),
            ]
            for method, evaluation in self.results.evaluations.items()
        ]
        keys = ["method", *(metric.key for metric in metrics)]
        return Table("", title, keys, ["method", *(metric.heading for metric in metrics)], rows)

    def _cell(self, metric: MetricColumn, evaluation: RunEvaluation) -> TableCell:
        cell = number_cell(metric.value(evaluation), metric.digits, metric.display_factor)
        relative = (
            ratio(metric, evaluation, self.reference_evaluation)
            if metric.key in DISPLAYED_RATIO_KEYS
            else None
        )
        return cell if relative is None else replace(cell, text=f"{cell.text} ({relative:.2f})")


def bench_table(results: Sequence[RelativeResults]) -> Table:
    """Return the table for scripts: one row per recording, frame step and method; all metrics."""
    run_keys = ["sequence", "every", "frames", "method", "state", "error"]
    metric_keys = [metric.key for metric in ALL_METRICS]
    ratio_keys = [f"{metric.key}_ratio" for metric in RATIO_METRICS]
    loop_closure_metrics = (
        (*LOOP_CLOSURE_METRICS, LOOP_CLOSURE_CPU_METRIC)
        if any(entry.results.has_loop_closure for entry in results)
        else ()
    )
    rows = [
        [
            *_run_cells(relative_results.results, method, evaluation),
            *(number_cell(metric.value(evaluation), metric.digits) for metric in ALL_METRICS),
            *(
                number_cell(ratio(metric, evaluation, relative_results.reference_evaluation), 3)
                for metric in RATIO_METRICS
            ),
            *(
                number_cell(metric.value(evaluation), metric.digits)
                for metric in loop_closure_metrics
            ),
        ]
        for relative_results in results
        for method, evaluation in relative_results.results.evaluations.items()
    ]
    keys = [*run_keys, *metric_keys, *ratio_keys, *(metric.key for metric in loop_closure_metrics)]
    return Table("bench", "All metrics", keys, keys, rows)


def _run_cells(result: SequenceResults, method: str, evaluation: RunEvaluation) -> list[TableCell]:
    recording = result.recording
    return [
        text_cell(recording.folder.resolve().name),
        number_cell(recording.frame_selection.step, 0),
        number_cell(len(recording.frame_stamps_s), 0),
        text_cell(method),
        text_cell(evaluation.outcome.state),
        text_cell(evaluation.outcome.error),
    ]


def _name_cell(method: str, evaluation: RunEvaluation) -> TableCell:
    """Return the method's name, with the state if the run has no result."""
    return text_cell(
        method, method if evaluation.is_done else f"{method}: {evaluation.outcome.state}"
    )


DATA_FILE, TABLE_FILE, CONFIG_FILE = "report.json", "bench.csv", "config.toml"


@dataclass(frozen=True)
class BenchMetadata:
    """Settings of a bench.

    Attributes:
        methods: Methods that run, in order.
        unavailable: Requested methods that are not installed.
        reference_method: Baseline for relative figures.
        frame_steps: Every n-th frame is used, with one pass over the recordings for each n.
        max_frames: Number of first frames of each recording to use; None for all.
        odometry: Settings of our methods.
        camera_file: Camera file for all recordings; None for each recording's own.
        time_limit_s: Time limit of each run.
        observer_factory: Made the observer of each run.
        orb_vocabulary: Vocabulary of ORB-SLAM3; "" if it does not run.
        created: Time of the bench.
    """

    methods: Sequence[str]
    unavailable: Sequence[UnavailableMethods]
    reference_method: str
    frame_steps: Sequence[int]
    max_frames: int | None
    odometry: OdometryConfig
    camera_file: Path | None
    time_limit_s: float
    observer_factory: ObserverFactory = NULL_OBSERVER
    orb_vocabulary: str = ""
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    def as_json(self) -> dict[str, Any]:
        """Return the settings and versions for report.json."""
        packages = {find_package(name) for name in self.methods if name in BASELINE_NAMES}
        baselines = {package.pip_names[0]: package.version for package in packages}
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "left_out": [each.as_json() for each in self.unavailable],
            "against": self.reference_method,
            "every": list(self.frame_steps),
            "first_frames": self.max_frames,
            "odometry": asdict(self.odometry),
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.observer_factory.settings,
            "orb_vocabulary": self.orb_vocabulary or None,
            "versions": {**collect_versions(), **dict(sorted(baselines.items()))},
            "processors": os.cpu_count(),
        }


def report_content(metadata: BenchMetadata, results: Sequence[RelativeResults]) -> dict[str, Any]:
    """Return the whole content of report.json."""
    return {"schema": 1, **metadata.as_json(), "results": [_as_json(each) for each in results]}


def _as_json(results: RelativeResults) -> dict[str, Any]:
    """Return one recording at one frame step, with the metrics of comparison and bench."""
    content = results.results.as_json()
    recording = results.results.recording
    methods = {
        method: {
            **content["methods"][method],
            **metric_values(evaluation),
            "ratios": metric_ratios(evaluation, results.reference_evaluation),
        }
        for method, evaluation in results.results.evaluations.items()
    }
    name = recording.folder.resolve().name
    return {**content, "name": name, "every": recording.frame_selection.step, "methods": methods}


def write_bench_report(
    folder: Path, metadata: BenchMetadata, results: Sequence[RelativeResults]
) -> None:
    """Write the files, report.json last. Raises InputError or UserFacingError as `write_file`.

    Args:
        folder: Folder of the report.
        metadata: Settings of the bench.
        results: Results by recording and frame step.
    """
    notes = (
        f"Methods: {', '.join(metadata.methods)}; `method` below applies to runs of the service.",
        f"--every {' '.join(map(str, metadata.frame_steps))}"
        + ("" if metadata.max_frames is None else f" --frames {metadata.max_frames}"),
    )
    config = format_effective_config(
        metadata.odometry, metadata.camera_file, metadata.observer_factory.config_tables, *notes
    )
    write_file(folder / CONFIG_FILE, config.encode())
    write_file(folder / TABLE_FILE, bench_table(results).as_csv().encode())
    text = json.dumps(report_content(metadata, results), indent=2)
    write_file(folder / DATA_FILE, f"{text}\n".encode())
