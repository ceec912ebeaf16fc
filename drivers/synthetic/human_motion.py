"""Motions of a person: a hand with a slow sweep and a tremor, and a walk through the room."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.synthetic.camera_motion import (
    CameraMotion,
    make_poses,
    rotate_yaw,
    rotations_from_vectors,
    smootherstep,
    smootherstep_integral,
)

# (amplitude in meters or radians, frequency in Hz).
Sinusoids = tuple[tuple[float, float], ...]
TREMOR_POSITION: Sinusoids = ((0.006, 0.7), (0.004, 1.3), (0.0015, 2.9), (0.0006, 5.3))
TREMOR_ROTATION: Sinusoids = ((0.010, 0.8), (0.006, 1.7), (0.003, 3.1), (0.0012, 5.9))
# The tremor of a hand: x y z, and a rotation vector in the camera's axes.
TREMOR = (TREMOR_POSITION,) * 3 + (TREMOR_ROTATION,) * 3


@dataclass(frozen=True)
class SinusoidSum:
    """Six sums of K sines, each sine with a whole number of periods in the duration."""

    amplitude: Array  # (6, K)
    angular_frequency: Array
    phase: Array

    @classmethod
    def random(
        cls, rng: np.random.Generator, duration_s: float, axes: tuple[Sinusoids, ...]
    ) -> "SinusoidSum":
        """Make sines of random phase near the given frequencies.

        A frequency that is rounded up gets a smaller amplitude, so its speed does not grow.

        Args:
            duration_s: Each sine has a whole number of periods in it.
            axes: The sines of each of the six axes.
        """
        longest = max(len(axis) for axis in axes)
        table = np.zeros((len(axes), longest, 2))
        for row, axis in zip(table, axes, strict=True):
            row[: len(axis)] = axis
        frequency = table[..., 1]
        periods = np.maximum(1.0, np.round(frequency * duration_s))
        scale = np.minimum(1.0, frequency * duration_s / periods)
        phase = rng.uniform(0.0, 2 * np.pi, frequency.shape)
        return cls(table[..., 0] * scale, 2 * np.pi * periods / duration_s, phase)

    def __call__(self, times_s: Array) -> Array:
        """Evaluate at `times_s` (N,); returns (N, 6)."""
        angle = times_s[:, None, None] * self.angular_frequency + self.phase
        result: Array = np.sum(self.amplitude * np.sin(angle), axis=2)
        return result


@dataclass(frozen=True)
class HandheldProfile:
    """How a camera is held: a sweep about a mean pose, with the tremor of the hand.

    Attributes:
        sweep: Sines of x y z, yaw, pitch and roll.
        turn_rad: Angle (N,) to the left that the person turns the camera besides, from the times
            (N,) and the length of the sequence, s; None for none.
        forward_m: Distance of the mean pose from the middle of the room along +y.
    """

    sweep: tuple[Sinusoids, ...]
    camera_height_m: float
    pitch_down_rad: float
    sweep_scale: float = 1.0
    tremor_scale: float = 1.0
    turn_rad: Callable[[Array, float], Array] | None = None
    forward_m: float = 0.0


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
        self, rng: np.random.Generator, duration_s: float, profile: HandheldProfile = ROOM_SWEEP
    ) -> None:
        self._sweep = SinusoidSum.random(rng, duration_s, profile.sweep)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._profile, self._duration_s = profile, duration_s

    def poses(self, times_s: Array) -> Array:
        profile = self._profile
        sweep = profile.sweep_scale * self._sweep(times_s)
        tremor = profile.tremor_scale * self._tremor(times_s)
        position_m = np.array([0.0, 0.0, profile.camera_height_m]) + sweep[:, :3] + tremor[:, :3]
        down_rad = sweep[:, 4] + profile.pitch_down_rad
        T = make_poses(position_m, sweep[:, 3], down_rad, sweep[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        if profile.turn_rad is not None:
            T = rotate_yaw(T, profile.turn_rad(times_s, self._duration_s))
        T[:, 1, 3] += profile.forward_m
        return T


# A little more than a Kinect's field of view, as tangents, and the fractions of each ray to check.
VIEW_TAN_X, VIEW_TAN_Y = np.linspace(-0.7, 0.7, 5), np.linspace(-0.52, 0.52, 5)
RAY_FRACTIONS = np.array([0.25, 0.5, 0.75, 1.0])
MAX_UP_SLOPE = -0.2
# Looks up from the floor into the room: angle and period.
LOOK_UP_RAD = 0.65
LOOK_UP_PERIOD_S = 10.0


class FloorMotion(HandheldMotion):
    """A handheld camera over the bare floor: most views show one plane."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        super().__init__(rng, duration_s, FLOOR_SWEEP)

    def poses(self, times_s: Array) -> Array:
        looks = round(self._duration_s / LOOK_UP_PERIOD_S)
        # It begins and ends at the floor; looking up takes a fifth of the period.
        up = LOOK_UP_RAD * np.sin(np.pi * looks * times_s / self._duration_s) ** 12
        T = super().poses(times_s)
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(
            up[:, None] * np.array([1.0, 0.0, 0.0])
        )
        return T

    def clearance_points_m(self, times_s: Array) -> Array:
        """Points (M, 3) between the camera and the floor that it sees when it does not look up."""
        T = super().poses(times_s)
        x, y = (grid.ravel() for grid in np.meshgrid(VIEW_TAN_X, VIEW_TAN_Y))
        rays = np.stack([x, y, np.ones_like(x)], axis=1) @ T[:, :3, :3].transpose(0, 2, 1)
        to_floor = -T[:, None, 2, 3] / np.minimum(rays[..., 2], MAX_UP_SLOPE)
        steps = to_floor[..., None, None] * RAY_FRACTIONS[:, None] * rays[..., None, :]
        result: Array = (T[:, None, None, :3, 3] + steps).reshape(-1, 3)
        return result


LAP_S = 20.0
RADIUS_M = 1.75
CAMERA_HEIGHT_M = 1.35
TARGET_HEIGHT_M = 0.6
# Deviation from an even walk, radians; the speed is then 0.3 to 0.8 meters per second.
PHASE_VARIATION_RAD = 0.4
SWAY: tuple[Sinusoids, ...] = (
    ((0.12, 0.10), (0.04, 0.30)),  # radius
    ((0.00, 0.10),),
    ((0.10, 0.10), (0.04, 0.25)),  # height
    ((0.05, 0.15),),  # yaw
    ((0.05, 0.15),),  # pitch
    ((0.08, 0.15),),  # roll
)
# Looks aside (yaw) and up and down (pitch): amplitude in radians, period in seconds.
# Between two of them the camera faces the middle; the fastest turn is 37 degrees per second.
LOOK_ASIDE = ((0.45, 5.0), (0.12, 4.0))


class OrbitMotion(CameraMotion):
    """Laps of about `LAP_S` around the middle; a shorter sequence goes part of one and back."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._sway = SinusoidSum.random(rng, duration_s, SWAY)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._start_rad = rng.uniform(0.0, 2 * np.pi)
        self._duration_s = duration_s

    def poses(self, times_s: Array) -> Array:
        sway, tremor = self._sway(times_s), self._tremor(times_s)
        along = self._orbit_angle_rad(times_s)
        aside, below = (self._look_offset_rad(times_s, *look) for look in LOOK_ASIDE)
        radius_m, height_m = RADIUS_M + sway[:, 0], CAMERA_HEIGHT_M + sway[:, 2]
        down = np.arctan2(height_m - TARGET_HEIGHT_M, radius_m)
        eye_m = np.stack([radius_m * np.cos(along), radius_m * np.sin(along), height_m], axis=1)
        yaw = along + np.pi / 2 + aside + sway[:, 3]  # to the middle, except when looking aside
        T = make_poses(eye_m + tremor[:, :3], yaw, down + below + sway[:, 4], sway[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        return T

    def _orbit_angle_rad(self, times_s: Array) -> Array:
        """Angle on the circle."""
        laps = round(self._duration_s / LAP_S)
        phase = 2 * np.pi * times_s / self._duration_s
        uneven = min(PHASE_VARIATION_RAD, self._duration_s / LAP_S)
        return self._start_rad + laps * phase + uneven * np.sin(phase)

    def _look_offset_rad(self, times_s: Array, amplitude_rad: float, every_s: float) -> Array:
        times = round(self._duration_s / every_s)
        return amplitude_rad * np.sin(2 * np.pi * times * times_s / self._duration_s) ** 3


TOUR_LAP_S = 30.0
# Half of the walk's length and width; its laps are 14 m long.
HALF_M = np.array([2.6, 1.8])
TOUR_CAMERA_HEIGHT_M = 1.35
LOOK_DOWN_RAD = 0.25
# Angle of the view from the room's middle toward the direction of travel.
LOOK_AHEAD_RAD = 1.8
# Variation from lap to lap: 0.3 to 0.6 meters per second, looks aside of up to 25 degrees.
TOUR_SWAY: tuple[Sinusoids, ...] = (
    ((0.10, 0.07), (0.02, 0.23)),  # outwards
    ((0.04, 0.11),),  # along the walk, radians
    ((0.08, 0.09), (0.04, 0.21)),  # height
    ((0.25, 0.11), (0.18, 0.17)),  # yaw
    ((0.07, 0.13), (0.05, 0.19)),  # pitch
    ((0.05, 0.15),),  # roll
)
# Deviation from an even walk, radians.
TOUR_PHASE_VARIATION_RAD = 0.25
# Every `REVERSE_EVERY_S` it turns around, walks back for `REVERSE_S` and turns around again.
REVERSE_EVERY_S = 90.0
REVERSE_S = 15.0
TURN_S = 10.0


class TourMotion(CameraMotion):
    """Laps of about `TOUR_LAP_S` around the middle, twice or more past the same places.

    A sequence that is too short for a lap goes part of one and back.
    """

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._sway = SinusoidSum.random(rng, duration_s, TOUR_SWAY)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._start_rad = rng.uniform(0.0, 2 * np.pi)
        self._duration_s = duration_s
        reversals = int(duration_s / REVERSE_EVERY_S)
        middles_s = (np.arange(reversals) + 0.5) * duration_s / max(reversals, 1)
        # (reversals, 2): the middle of turning around, first to walk back and then to walk on.
        self._turn_times_s = np.stack(
            [middles_s - REVERSE_S / 2, middles_s + REVERSE_S / 2], axis=1
        )
        self._forward_s = duration_s - 2 * REVERSE_S * reversals
        self._laps = int(self._forward_s / TOUR_LAP_S + 0.25)

    def poses(self, times_s: Array) -> Array:
        sway, tremor = self._sway(times_s), self._tremor(times_s)
        along = self._tour_angle_rad(times_s) + sway[:, 1]
        out = np.stack([np.cos(along), np.sin(along)], axis=1)
        eye_m = np.column_stack([out * (HALF_M + sway[:, :1]), TOUR_CAMERA_HEIGHT_M + sway[:, 2]])
        # Left of +y by the angle to the middle of the room, then toward the direction of travel.
        middle = along + np.pi / 2
        yaw = middle - LOOK_AHEAD_RAD * self._direction(times_s) + sway[:, 3]
        T = make_poses(eye_m + tremor[:, :3], yaw, LOOK_DOWN_RAD + sway[:, 4], sway[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        return T

    def _direction(self, times_s: Array) -> Array:
        """1 while it walks forward, -1 while it walks back, between while it turns around."""
        progress = smootherstep(self._turn_progress(times_s))
        result: Array = 1.0 - 2.0 * np.sum(progress[..., 0] - progress[..., 1], axis=1)
        return result

    def _tour_angle_rad(self, times_s: Array) -> Array:
        """Angle on the tour: the integral of `_direction`, at a speed that gives whole laps."""
        turned_s = TURN_S * smootherstep_integral(self._turn_progress(times_s))
        walked_s = times_s - 2.0 * np.sum(turned_s[..., 0] - turned_s[..., 1], axis=1)
        uneven = min(TOUR_PHASE_VARIATION_RAD, self._duration_s / TOUR_LAP_S)
        phase = 2 * np.pi * times_s / self._duration_s
        pace = 2 * np.pi * self._laps / self._forward_s
        result: Array = self._start_rad + pace * walked_s + uneven * np.sin(phase)
        return result

    def _turn_progress(self, times_s: Array) -> Array:
        """Progress (N, reversals, 2) of each time it turns around, 0 to 1 during the turn."""
        return (times_s[:, None, None] - self._turn_times_s) / TURN_S + 0.5
