"""Motions that are hard on purpose: to a bare wall, with fast turns, too slow to be seen."""

import numpy as np

from drivers.geometry import Array, rotation_from_vector
from drivers.synthetic.easing import eased, ramp
from drivers.synthetic.hand import THROUGH_ROOM, Carriage, HandPath
from drivers.synthetic.path import Path, facing, rotations

# A hand that holds the camera level, two metres before the wall at +y.
BEFORE_WALL = Carriage(
    (
        ((0.15, 0.10), (0.06, 0.20)),
        ((0.08, 0.10),),
        ((0.06, 0.10), (0.03, 0.25)),
        ((0.08, 0.10), (0.04, 0.20)),
        ((0.04, 0.10),),
        ((0.04, 0.15),),
    ),
    eye_height_m=1.45,
    look_down_rad=0.0,
)
TOWARDS_WALL_M = 0.5
ASIDE_RAD = 1.15
TO_THE_WALL_EVERY_S = 10.0
# Two turns in so many seconds, there and back, each of them half a second long; how far they go, in
# turns. Halfway through, the rate is pi times that: 2.5 and 3.8 radians a second.
TURNS_EVERY_S = 6.0
TURN_S = 0.5
TURNS_RAD = (0.8, 1.2)
CREEP_M_S = 0.001


class WallPath(Path):
    """Looks aside, then for a third of the time straight at the wall at +y, then aside again."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._hand = HandPath(rng, duration_s, BEFORE_WALL)
        looks = max(1, round(duration_s / TO_THE_WALL_EVERY_S))
        self._period_s = duration_s / looks

    def poses(self, times_s: Array) -> Array:
        """See `Path`."""
        nearing = 0.5 - 0.5 * np.cos(2 * np.pi * times_s / self._period_s)
        T = _turned(self._hand.poses(times_s), ASIDE_RAD * (1.0 - eased(2.0 * nearing - 0.5)))
        T[:, 1, 3] += TOWARDS_WALL_M
        return T


class FastTurnPath(Path):
    """A hand that sweeps about, and turns the camera away and back in no time."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._hand = HandPath(rng, duration_s, THROUGH_ROOM, sweep_scale=0.5)
        self._pairs = max(1, round(duration_s / TURNS_EVERY_S))
        self._period_s = duration_s / self._pairs

    def poses(self, times_s: Array) -> Array:
        """See `Path`."""
        yaw_rad = np.zeros_like(times_s)
        for pair in range(self._pairs):
            since_s = times_s - pair * self._period_s
            away = ramp((since_s - 0.25 * self._period_s) / TURN_S)
            back = ramp((since_s - 0.75 * self._period_s) / TURN_S)
            yaw_rad += TURNS_RAD[pair % len(TURNS_RAD)] * (away - back)
        return _turned(self._hand.poses(times_s), yaw_rad)


class CreepPath(Path):
    """Straight on by a millimetre a second, without a tremor; and back, where it is looped."""

    def __init__(self, rng: np.random.Generator, round_trip_s: float) -> None:
        """`round_trip_s` may be infinite: it then never comes back."""
        yaw_rad, sideways_rad = rng.uniform(-np.pi, np.pi, 2)
        down_rad = THROUGH_ROOM.look_down_rad
        self._R = facing(np.array([yaw_rad]), np.array([down_rad]), np.zeros(1))[0]
        self._direction = rotation_from_vector([0.0, 0.0, sideways_rad]) @ [1.0, 0.0, 0.0]
        self._round_trip_s = round_trip_s

    def poses(self, times_s: Array) -> Array:
        """See `Path`."""
        along_m = CREEP_M_S * np.minimum(times_s, self._round_trip_s - times_s)
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, :3] = self._R
        T[:, :3, 3] = along_m[:, None] * self._direction
        T[:, 2, 3] += THROUGH_ROOM.eye_height_m
        return T


def _turned(T_world_camera: Array, yaw_rad: Array) -> Array:
    """Each pose (N, 4, 4) turned to the left where it stands, by its own angle (N,)."""
    zero = np.zeros_like(yaw_rad)
    turned = T_world_camera.copy()
    turns = rotations(np.stack([zero, zero, yaw_rad], axis=1))
    turned[:, :3, :3] = turns @ T_world_camera[:, :3, :3]
    return turned
