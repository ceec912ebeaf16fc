"""Short sequences of the virtual Kinect for consistency checks, with different settings."""

from collections.abc import Sequence

from drivers.synthetic.config import MotionKind, ShutterTiming, SyntheticConfig

SEEDS = tuple(range(101, 113))
DURATION_S = 5.0
MOTIONS = (MotionKind.HAND_HELD, MotionKind.ORBIT, MotionKind.FLOOR, MotionKind.SMOOTH)
TIMINGS = {
    "ideal": ShutterTiming(0.0, 0.0),
    "rolling-10": ShutterTiming(0.020, 0.010),
    "rolling--12": ShutterTiming(0.020, -0.012),
}


def make_configs(seeds: Sequence[int]) -> dict[str, SyntheticConfig]:
    """Configurations by name; each seed has its own room, motion and sensor timing."""
    kinds = list(TIMINGS)
    configs = {}
    for number, seed in enumerate(seeds):
        motion, kind = MOTIONS[number % len(MOTIONS)], kinds[number % len(kinds)]
        configs[f"{motion}-room{seed}-{kind}"] = SyntheticConfig(
            seed=seed, duration_s=DURATION_S, motion=motion, timing=TIMINGS[kind]
        )
    return configs
