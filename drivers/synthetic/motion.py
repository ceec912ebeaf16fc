"""How the camera moves: the paths by name. All built-in ones can be looped."""

import numpy as np

from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.hand import THROUGH_ROOM, FloorPath, HandPath
from drivers.synthetic.orbit import OrbitPath
from drivers.synthetic.path import Path
from drivers.synthetic.staged import CreepPath, FastTurnPath, WallPath
from drivers.synthetic.tour import TourPath
from drivers.synthetic.track import TrackPath


def make_path(config: SyntheticConfig, room_height_m: float) -> Path:
    """The path that `config` asks for. Raises InputError if the track cannot be used."""
    if config.track is not None:
        return TrackPath.read(config.track, config, room_height_m)
    rng, duration_s = np.random.default_rng([config.seed, 1]), config.duration_s
    match config.motion:
        case Motion.HAND_HELD:
            return HandPath(rng, duration_s, THROUGH_ROOM)
        case Motion.SMOOTH:
            return HandPath(rng, duration_s, THROUGH_ROOM, tremor_scale=0.0)
        case Motion.STILL:
            return HandPath(rng, duration_s, THROUGH_ROOM, sweep_scale=0.0, tremor_scale=0.0)
        case Motion.FLOOR:
            return FloorPath(rng, duration_s)
        case Motion.ORBIT:
            return OrbitPath(rng, duration_s)
        case Motion.TOUR:
            return TourPath(rng, duration_s)
        case Motion.WALL:
            return WallPath(rng, duration_s)
        case Motion.FAST_TURN:
            return FastTurnPath(rng, duration_s)
        case Motion.CREEP:
            return CreepPath(rng, duration_s if config.loop else np.inf)
