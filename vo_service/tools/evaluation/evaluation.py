"""Evaluation of a trajectory against its ground truth: all metrics, as JSON and as a table."""

from dataclasses import asdict, dataclass

import numpy as np

from drivers.core.geometry import MAX_STAMP_DIFFERENCE_S, Array, Trajectory
from vo_service.terminal import format_columns, format_mm
from vo_service.tools.evaluation.metrics import (
    associate,
    best_alignment,
    consecutive_pairs,
    coverage,
    first_pose_alignment,
    pairs_one_second_apart,
    position_errors_m,
    relative_errors,
    rms,
)


@dataclass(frozen=True)
class Evaluation:
    """Result of `evaluate`; None means that the trajectory is too short for this metric.

    Attributes:
        ate_*: Distance from the truth after the best rigid alignment.
        mean_global_error_m: Mean distance from the truth after alignment of the first poses.
        rpe_frame_*: Root mean square of the relative error from frame to frame.
        rpe_1s_*: The same over one second.
        coverage: Fraction of the frames with truth that have a pose, 0 to 1.
        matched: Number of poses with ground truth.
    """

    ate_rmse_m: float
    ate_mean_m: float
    ate_median_m: float
    ate_max_m: float
    mean_global_error_m: float
    rpe_frame_m: float | None
    rpe_frame_deg: float | None
    rpe_1s_m: float | None
    rpe_1s_deg: float | None
    coverage: float | None
    poses: int
    matched: int

    def as_json(self) -> dict[str, float | None]:
        """Return one flat object with the fields as keys."""
        return asdict(self)

    def rows(self) -> list[tuple[str, str]]:
        """Return label and value of each table row; "-" for None."""
        return [
            ("ATE, RMSE", format_mm(self.ate_rmse_m)),
            ("ATE, mean", format_mm(self.ate_mean_m)),
            ("ATE, median", format_mm(self.ate_median_m)),
            ("ATE, largest", format_mm(self.ate_max_m)),
            ("mean global error", format_mm(self.mean_global_error_m)),
            (
                "RPE, one frame",
                f"{format_mm(self.rpe_frame_m)}  {_format_degrees(self.rpe_frame_deg)}",
            ),
            ("RPE, one second", f"{format_mm(self.rpe_1s_m)}  {_format_degrees(self.rpe_1s_deg)}"),
            ("coverage", f"{'-':>9}" if self.coverage is None else f"{100 * self.coverage:9.1f} %"),
            ("poses", f"{self.poses:9d}"),
            ("matched", f"{self.matched:9d}"),
        ]

    def as_table(self) -> str:
        """Return aligned text for a terminal, without a final newline."""
        return format_columns(self.rows())


# These keys are null without a ground truth.
EVALUATION_KEYS = tuple(Evaluation.__dataclass_fields__)


def evaluate(
    trajectory: Trajectory,
    truth: Trajectory,
    frame_stamps_s: Array | None = None,
    max_difference_s: float = MAX_STAMP_DIFFERENCE_S,
) -> Evaluation:
    """Compare a trajectory with the ground truth, each in its own world frame.

    Args:
        frame_stamps_s: (F,) ascending stamps of all delivered frames; see `coverage`.

    Raises:
        InputError: Fewer than 3 poses have ground truth.
    """
    matched = associate(trajectory, truth, max_difference_s)
    errors_m = position_errors_m(matched, best_alignment(matched))
    per_frame = relative_errors(matched, consecutive_pairs(matched))
    per_second = relative_errors(matched, pairs_one_second_apart(matched))
    return Evaluation(
        ate_rmse_m=float(np.sqrt(np.mean(errors_m**2))),
        ate_mean_m=float(np.mean(errors_m)),
        ate_median_m=float(np.median(errors_m)),
        ate_max_m=float(np.max(errors_m)),
        mean_global_error_m=float(
            np.mean(position_errors_m(matched, first_pose_alignment(matched)))
        ),
        rpe_frame_m=rms(per_frame.translation_m),
        rpe_frame_deg=rms(per_frame.rotation_deg),
        rpe_1s_m=rms(per_second.translation_m),
        rpe_1s_deg=rms(per_second.rotation_deg),
        coverage=coverage(trajectory.stamps_s, truth.stamps_s, frame_stamps_s, max_difference_s),
        poses=len(trajectory),
        matched=len(matched.stamps_s),
    )


def _format_degrees(value: float | None) -> str:
    return f"{'-':>8}" if value is None else f"{value:8.3f} deg"
