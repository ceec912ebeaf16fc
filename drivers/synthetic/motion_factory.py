"""Camera motions by name. All built-in ones can be looped."""

import numpy as np

from drivers.synthetic import MotionKind, SyntheticConfig
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.human_motion import (
    ROOM_SWEEP,
    FloorMotion,
    HandheldMotion,
    OrbitMotion,
    TourMotion,
)
from drivers.synthetic.scripted_motion import (
    CreepMotion,
    FastTurnMotion,
    RecordedMotion,
    WallMotion,
)


def make_motion(config: SyntheticConfig, room_height_m: float) -> CameraMotion:
    """Make the motion of `config`.

    Raises:
        InputError: If the track cannot be used.
    """
    if config.track is not None:
        return RecordedMotion.read(config.track, config, room_height_m)
    rng, duration_s = np.random.default_rng([config.seed, 1]), config.duration_s
    match config.motion:
        case MotionKind.HAND_HELD:
            return HandheldMotion(rng, duration_s, ROOM_SWEEP)
        case MotionKind.SMOOTH:
            return HandheldMotion(rng, duration_s, ROOM_SWEEP, tremor_scale=0.0)
        case MotionKind.STILL:
            return HandheldMotion(rng, duration_s, ROOM_SWEEP, sweep_scale=0.0, tremor_scale=0.0)
        case MotionKind.FLOOR:
            return FloorMotion(rng, duration_s)
        case MotionKind.ORBIT:
            return OrbitMotion(rng, duration_s)
        case MotionKind.TOUR:
            return TourMotion(rng, duration_s)
        case MotionKind.WALL:
            return WallMotion(rng, duration_s)
        case MotionKind.FAST_TURN:
            return FastTurnMotion(rng, duration_s)
        case MotionKind.CREEP:
            return CreepMotion(rng, duration_s if config.loop else np.inf)
