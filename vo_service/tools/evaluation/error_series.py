"""The errors pose by pose, as they are drawn over the frames."""

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

    stamps_s     (M,) of the poses
    global_m     (M,) distance from the truth with the first matched poses joined
    steps        (M - 1,) error of each motion from one pose to the next
    """

    stamps_s: Array
    global_error_m: Array
    step_errors: RelativeErrors


def error_series(matched: MatchedPoses) -> ErrorSeries:
    """What the mean global error is the mean of, and the RPE of one frame the RMS of."""
    return ErrorSeries(
        matched.stamps_s,
        position_errors_m(matched, first_pose_alignment(matched)),
        relative_errors(matched, consecutive_pairs(matched)),
    )
