"""Summary at the end of a run, as JSON and as a table."""

import logging
from dataclasses import dataclass
from typing import Any

from drivers.camera import CameraCounters
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory
from vo_service.service_statistics import ServiceStatistics
from vo_service.terminal import format_columns, format_mm
from vo_service.tools.evaluation.evaluation import EVALUATION_KEYS, Evaluation, evaluate
from vo_service.types.estimate import OnlineFocalLength, OnlineTiming

logger = logging.getLogger(__name__)

# These keys are null if the timing is exact, or fixed.
TIMING_KEYS = (
    "readout_ms",
    "readout_sigma_ms",
    "depth_offset_ms",
    "depth_offset_sigma_ms",
    "sensor_timing_source",
)
FOCAL_KEYS = ("focal_scale", "focal_scale_sigma", "focal_disagreement", "focal_source")


@dataclass(frozen=True)
class RunSummary:
    """Statistics of a run, and the evaluation of its trajectory if the truth is known."""

    statistics: ServiceStatistics
    counters: CameraCounters
    evaluation: Evaluation | None
    loop_closure: "LoopClosureSummary | None" = None

    def as_json(self) -> dict[str, Any]:
        """Return one flat object; null for values that cannot be computed."""
        statistics, counters = self.statistics, self.counters
        latency = statistics.make_latency_report({})
        metrics = self.evaluation.as_json() if self.evaluation else dict.fromkeys(EVALUATION_KEYS)
        return {
            "frames": statistics.frames,
            "failed": statistics.failed,
            "skipped": counters.skipped + statistics.out_of_order,
            "dropped": counters.dropped,
            "fps": round(statistics.mean_fps, 3),
            "latency_p50_ms": round(latency.p50_ms, 3),
            "latency_p99_ms": round(latency.p99_ms, 3),
            "cpu_ms_per_frame": round(statistics.cpu_ms_per_frame, 3),
            "stage_ms": {name: round(ms, 3) for name, ms in statistics.stage_ms.items()},
            **_timing_json(statistics.timing),
            **_focal_json(statistics.focal_length),
            "depth_noise_per_m": statistics.depth_noise_per_m,
            **metrics,
            **(self.loop_closure.as_json() if self.loop_closure else {}),
        }

    def as_table(self) -> str:
        """Return aligned text for a terminal."""
        statistics, counters = self.statistics, self.counters
        latency = statistics.make_latency_report({})
        stages = ", ".join(f"{name} {ms:.2f}" for name, ms in statistics.stage_ms.items())
        rows = [
            ("frames", f"{statistics.frames:6d}"),
            ("failed", f"{statistics.failed:6d}"),
            ("skipped", f"{counters.skipped + statistics.out_of_order:6d}"),
            ("dropped", f"{counters.dropped:6d}"),
            ("rate", f"{statistics.mean_fps:6.1f} frames/s"),
            ("latency", f"{latency.p50_ms:6.1f} ms median, {latency.p99_ms:.1f} ms p99"),
            ("CPU a frame", f"{statistics.cpu_ms_per_frame:6.1f} ms median"),
            ("its stages", f"  {stages} ms (medians of the frames with the stage)"),
            *_timing_rows(statistics.timing),
            *_focal_rows(statistics.focal_length),
            *_noise_rows(statistics.depth_noise_per_m),
        ]
        rows += self.evaluation.rows() if self.evaluation else []
        rows += self.loop_closure.rows() if self.loop_closure else []
        return format_columns(rows)


def _timing_rows(timing: OnlineTiming | None) -> list[tuple[str, str]]:
    """Return the table rows of the sensor's timing; none if it is exact."""
    if timing is None:
        return []
    values_s = (
        ("readout", timing.readout_s, timing.readout_sigma_s),
        ("depth offset", timing.depth_offset_s, timing.depth_offset_sigma_s),
    )
    return [
        (name, f"{1e3 * value_s:6.1f} ms +- {1e3 * sigma_s:.1f} ({timing.source})")
        for name, value_s, sigma_s in values_s
    ]


def _timing_json(timing: OnlineTiming | None) -> dict[str, Any]:
    """Return the keys of the sensor's timing; null if it is exact."""
    if timing is None:
        return dict.fromkeys(TIMING_KEYS)
    values = (
        timing.readout_s,
        timing.readout_sigma_s,
        timing.depth_offset_s,
        timing.depth_offset_sigma_s,
    )
    rounded = (round(1e3 * value_s, 3) for value_s in values)
    return dict(zip(TIMING_KEYS, (*rounded, timing.source), strict=True))


def _focal_rows(focal_length: OnlineFocalLength | None) -> list[tuple[str, str]]:
    """Return the table row of the focal length; none if it is exact."""
    if focal_length is None:
        return []
    percent = 100.0 * (focal_length.scale - 1.0)
    text = f"{percent:+6.1f} % +- {100.0 * focal_length.sigma:.1f} of that of the intrinsics"
    if focal_length.source:
        text += f" ({focal_length.source})"
    if focal_length.is_refused:
        text += "; what was learned does not fit better"
    if focal_length.disagreement is not None:
        text += f"; by depth {100.0 * focal_length.disagreement:+.1f} % more than by brightness"
    return [("focal length", text)]


def _noise_rows(depth_noise_per_m: float | None) -> list[tuple[str, str]]:
    """Return the table row of the noise of depth; none if it is not known."""
    if depth_noise_per_m is None:
        return []
    at_1_m_mm, at_3_m_mm = (1e3 * depth_m**2 * depth_noise_per_m for depth_m in (1.0, 3.0))
    return [("depth noise", f"{at_1_m_mm:6.1f} mm at 1 m, {at_3_m_mm:.1f} mm at 3 m")]


def _focal_json(focal_length: OnlineFocalLength | None) -> dict[str, Any]:
    """Return the keys of the focal length; null for what is not known."""
    if focal_length is None:
        return dict.fromkeys(FOCAL_KEYS)
    values = (focal_length.scale, focal_length.sigma, focal_length.disagreement)
    rounded = (None if value is None else round(value, 5) for value in values)
    return dict(zip(FOCAL_KEYS, (*rounded, focal_length.source), strict=True))


@dataclass(frozen=True)
class LoopClosureSummary:
    """Results of loop closure.

    Attributes:
        evaluation: Metrics of the optimized trajectory; None without a truth.
    """

    map_keyframes: int
    loop_closures: int
    evaluation: Evaluation | None

    def as_json(self) -> dict[str, Any]:
        """Return the additional keys of the summary."""
        ate_m = self.evaluation.ate_rmse_m if self.evaluation else None
        global_m = self.evaluation.mean_global_error_m if self.evaluation else None
        return {
            "map_keyframes": self.map_keyframes,
            "loop_closures": self.loop_closures,
            "optimized_ate_rmse_m": ate_m,
            "optimized_mean_global_error_m": global_m,
        }

    def rows(self) -> list[tuple[str, str]]:
        """Return the additional table rows."""
        counts = f"{self.map_keyframes:6d}, {self.loop_closures}"
        rows = [("keyframes, loop closures", counts)]
        if self.evaluation is not None:
            optimized = self.evaluation
            rows.append(("optimized ATE, RMSE", format_mm(optimized.ate_rmse_m)))
            rows.append(("optimized global error", format_mm(optimized.mean_global_error_m)))
        return rows


def evaluate_if_possible(
    trajectory: Trajectory, ground_truth: Trajectory | None, frames_s: Array
) -> Evaluation | None:
    """Evaluate a trajectory; None without a truth or with too few matched poses."""
    if ground_truth is None or not len(trajectory):
        return None
    try:
        return evaluate(trajectory, ground_truth, frames_s)
    except InputError as error:
        logger.warning("no evaluation: %s", error)
        return None
