"""Time budget of each stage of the direct odometry."""

from collections.abc import Mapping

# Milliseconds of processor time, as the mean over all frames, with a rolling shutter. The sum is a
# quarter of one processor at 30 Hz. Without a rolling shutter, half of `align` is enough.
STAGE_BUDGET_MS: Mapping[str, float] = {
    "images": 0.5,
    "align": 4.5,
    "recovery": 1.0,
    "covariance": 1.0,
    "refine": 0.5,
    "keyframe": 0.5,
}
