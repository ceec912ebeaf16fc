"""Short sequences of the virtual Kinect to judge a covariance by: all else differs between them."""

from collections.abc import Sequence

from drivers.synthetic.config import Motion, SyntheticConfig, Timing

SEEDS = tuple(range(101, 113))
DURATION_S = 5.0
MOTIONS = (Motion.HAND_HELD, Motion.ORBIT, Motion.FLOOR, Motion.SMOOTH)
TIMINGS = {
    "ideal": Timing(0.0, 0.0),
    "rolling-10": Timing(0.020, 0.010),
    "rolling--12": Timing(0.020, -0.012),
}


def rooms(seeds: Sequence[int]) -> dict[str, SyntheticConfig]:
    """By name: each seed is another room, another motion and another timing than the one before."""
    kinds = list(TIMINGS)
    found = {}
    for number, seed in enumerate(seeds):
        motion, kind = MOTIONS[number % len(MOTIONS)], kinds[number % len(kinds)]
        found[f"{motion}-room{seed}-{kind}"] = SyntheticConfig(
            seed=seed, duration_s=DURATION_S, motion=motion, timing=TIMINGS[kind]
        )
    return found
