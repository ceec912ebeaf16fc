"""Errors per pose, for plots over the frames."""

from dataclasses import dataclass

from drivers.core.geometry import Array
from vo_service.tools.evaluation.association import MatchedPoses
from vo_service.tools.evaluation.metrics import (
    RelativeErrors,
    consecutive_pairs,
    first_pose_alignment,
    position_errors_m,
    relative_errors,
)


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of M matched poses.

    Attributes:
        stamps_s: (M,) stamps of the poses.
        global_error_m: (M,) distance from the truth after alignment of the first matched poses.
        step_errors: (M - 1,) error of each motion from one pose to the next.
    """

    stamps_s: Array
    global_error_m: Array
    step_errors: RelativeErrors


def error_series(matched: MatchedPoses) -> ErrorSeries:
    """Return the errors behind the mean global error (mean) and the RPE of one frame (RMS)."""
    return ErrorSeries(
        matched.stamps_s,
        position_errors_m(matched, first_pose_alignment(matched)),
        relative_errors(matched, consecutive_pairs(matched)),
    )
