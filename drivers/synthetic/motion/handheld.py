"""Motion of a handheld camera: over a room, or over its floor."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.synthetic.motion.base import CameraMotion, look_rotations, rotations_from_vectors
from drivers.synthetic.motion.sinusoidal import TREMOR, Sinusoids, SinusoidSum


@dataclass(frozen=True)
class HandheldProfile:
    """The sweep of a handheld camera about a mean pose: x y z, yaw, pitch and roll."""

    sweep: tuple[Sinusoids, ...]
    camera_height_m: float
    pitch_down_rad: float


ROOM_SWEEP = HandheldProfile(
    (
        ((0.55, 0.05), (0.15, 0.15)),
        ((0.35, 0.10), (0.12, 0.20)),
        ((0.08, 0.10), (0.05, 0.25)),
        ((0.70, 0.05), (0.25, 0.15)),
        ((0.12, 0.10), (0.10, 0.20)),
        ((0.06, 0.15),),
    ),
    camera_height_m=1.50,
    pitch_down_rad=0.45,
)
# About as fast as freiburg1/floor: a quarter of a meter and 15 degrees per second.
FLOOR_SWEEP = HandheldProfile(
    (
        ((0.60, 0.05), (0.20, 0.15)),
        ((0.40, 0.10), (0.12, 0.20)),
        ((0.08, 0.10), (0.04, 0.25)),
        ((0.50, 0.05), (0.20, 0.15)),
        ((0.08, 0.10), (0.04, 0.20)),
        ((0.08, 0.15),),
    ),
    camera_height_m=1.15,
    pitch_down_rad=1.25,
)


class HandheldMotion(CameraMotion):
    """A sweep about the middle of the room, with the tremor of a hand."""

    def __init__(
        self,
        rng: np.random.Generator,
        duration_s: float,
        profile: HandheldProfile,
        sweep_scale: float = 1.0,
        tremor_scale: float = 1.0,
    ) -> None:
        self._sweep = SinusoidSum.random(rng, duration_s, profile.sweep)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._profile = profile
        self._sweep_scale, self._tremor_scale = sweep_scale, tremor_scale

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        sweep = self._sweep_scale * self._sweep(times_s)
        tremor = self._tremor_scale * self._tremor(times_s)
        height_m, down_rad = self._profile.camera_height_m, self._profile.pitch_down_rad
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, 3] = np.array([0.0, 0.0, height_m]) + sweep[:, :3] + tremor[:, :3]
        T[:, :3, :3] = look_rotations(sweep[:, 3], sweep[:, 4] + down_rad, sweep[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        return T


# A little more than a Kinect's field of view, as tangents, and the fractions of each ray to check.
VIEW_TAN_X, VIEW_TAN_Y = np.linspace(-0.7, 0.7, 5), np.linspace(-0.52, 0.52, 5)
RAY_FRACTIONS = np.array([0.25, 0.5, 0.75, 1.0])
MAX_UP_SLOPE = -0.2
# Looks up from the floor into the room: angle and period.
LOOK_UP_RAD = 0.65
LOOK_UP_PERIOD_S = 10.0


class FloorMotion(CameraMotion):
    """A handheld camera over the bare floor: most views show one plane."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._handheld = HandheldMotion(rng, duration_s, FLOOR_SWEEP)
        self._duration_s = duration_s

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        looks = round(self._duration_s / LOOK_UP_PERIOD_S)
        # It begins and ends at the floor; looking up takes a fifth of the period.
        up = LOOK_UP_RAD * np.sin(np.pi * looks * times_s / self._duration_s) ** 12
        T = self._handheld.poses(times_s)
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(
            up[:, None] * np.array([1.0, 0.0, 0.0])
        )
        return T

    def clearance_points_m(self, times_s: Array) -> Array:
        """Points (M, 3) between the camera and the floor that it sees when it does not look up."""
        T = self._handheld.poses(times_s)
        x, y = (grid.ravel() for grid in np.meshgrid(VIEW_TAN_X, VIEW_TAN_Y))
        rays = np.stack([x, y, np.ones_like(x)], axis=1) @ T[:, :3, :3].transpose(0, 2, 1)
        to_floor = -T[:, None, 2, 3] / np.minimum(rays[..., 2], MAX_UP_SLOPE)
        steps = to_floor[..., None, None] * RAY_FRACTIONS[:, None] * rays[..., None, :]
        result: Array = (T[:, None, None, :3, 3] + steps).reshape(-1, 3)
        return result
