"""What each stage of the keyframe odometry may take."""

from collections.abc import Mapping

# Milliseconds of processor time, mean of all frames, those in which it does not run among them: a
# quarter of one processor at 30 Hz. With a rolling shutter; without one, half of `align` will do.
STAGE_BUDGET_MS: Mapping[str, float] = {
    "images": 0.5,
    "align": 4.5,
    "recovery": 1.0,
    "certainty": 1.0,
    "settle": 0.5,
    "keyframe": 0.5,
}
