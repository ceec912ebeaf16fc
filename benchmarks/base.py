"""Tracking of a base by camera, floor and wheels: at bare walls, with slip, with late stamps."""

import argparse
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from benchmarks.hard_cases import read_scene
from benchmarks.harness import Table, option
from benchmarks.rendered_sequences import render_all
from benchmarks.tracking import evaluate_accuracy, open_frames_with_truth, track
from drivers.core.geometry import (
    R_BODY_OPTICAL,
    T_BODY_CAMERA,
    Array,
    Trajectory,
    inverse,
    rigid_transform,
    so3_exp,
    so3_log,
)
from vo_service.config_tables import WheelOdometryConfig
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.warm_up import warm_up
from vo_service.wheel_odometry.planar_pose import PlanarPose, planar_part
from vo_service.wheel_odometry.wheel_odometry import NullWheelOdometry, WheelMotion, WheelOdometry
from vo_service.wheel_odometry.wheel_reading import WheelReading, encode_wheel_reading

# The camera of the scene wall-drive is level, at this height.
ROBOT_MOUNT = rigid_transform(R_BODY_OPTICAL, (0.0, 0.0, 1.3))
SCENES = {"wall": T_BODY_CAMERA, "wall-drive": ROBOT_MOUNT}
SLIP_PERIOD_S, SLIP_S = 5.0, 0.5
TRANSLATION_SCALE, ROTATION_SCALE = 1.02, 1.03
WHEEL_PERIOD_S = 0.02
FIRST_FRAMES = (0, 1, 2)
TABLE = Table(
    *(46, "frames:8d", "degraded:10d", "lost:6d", "epochs:8d", "ATE:8.1mm", "largest:9.1mm"),
    *("beyond 3 sigmas:17d", "CPU ms:8.2f"),
)


@dataclass(frozen=True)
class Variant:
    """What is known of the base.

    Attributes:
        is_planar: Whether it stays on its floor.
        has_wheels: Whether it has wheels, with scale errors of 2 and 3 % and noise.
        slip: Share by which they turn too far for half a second in five.
        late_s: Error of their stamps.
    """

    is_planar: bool = False
    has_wheels: bool = False
    slip: float = 0.0
    late_s: float = 0.0


HAND_HELD = {"camera alone": Variant(), "6-DoF odometry": Variant(has_wheels=True)}
ROBOT = {
    "camera alone": Variant(),
    "planar": Variant(is_planar=True),
    "wheels": Variant(has_wheels=True),
    "planar, wheels": Variant(is_planar=True, has_wheels=True),
    "wheels, 40 % slip": Variant(has_wheels=True, slip=0.4),
    "planar, wheels, 40 % slip": Variant(is_planar=True, has_wheels=True, slip=0.4),
    "planar, wheels, 100 ms late": Variant(is_planar=True, has_wheels=True, late_s=0.1),
}


class TrueMotion:
    """True poses of the base at any time."""

    def __init__(self, truth: Trajectory, T_base_camera: Array) -> None:
        T_world_base = truth.T_world_camera @ inverse(T_base_camera)
        self.stamps_s, self._positions_m = truth.stamps_s, T_world_base[:, :3, 3]
        self._rotations = Slerp(self.stamps_s, Rotation.from_matrix(T_world_base[:, :3, :3]))

    def between(self, from_s: float, to_s: float) -> Array:
        """4x4 motion of the base between two stamps."""
        return inverse(self._pose_at(from_s)) @ self._pose_at(to_s)

    def _pose_at(self, stamp_s: float) -> Array:
        known_s = np.clip(stamp_s, self.stamps_s[0], self.stamps_s[-1])
        position_m = [np.interp(known_s, self.stamps_s, axis) for axis in self._positions_m.T]
        return rigid_transform(self._rotations(known_s).as_matrix(), position_m)


class HandOdometry(NullWheelOdometry):
    """The odometry of a camera that moves in all directions, with errors of scale and noise."""

    def __init__(self, motion: TrueMotion) -> None:
        self._motion, self._rng = motion, np.random.default_rng(1)

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """The motion as it is told."""
        T = self._motion.between(from_s, to_s)
        translation_m, rotation_rad = T[:3, 3], so3_log(T[:3, :3])
        sigma_m = 0.05 * np.linalg.norm(translation_m) + 0.5e-3
        sigma_rad = 0.05 * np.linalg.norm(rotation_rad) + 1e-3
        noise = 0.2 * self._rng.normal(size=6)
        moved = rigid_transform(
            so3_exp(ROTATION_SCALE * rotation_rad + sigma_rad * noise[3:]),
            TRANSLATION_SCALE * translation_m + sigma_m * noise[:3],
        )
        return WheelMotion(moved, np.array([sigma_m] * 3 + [sigma_rad] * 3))


class SimulatedWheels(NullWheelOdometry):
    """Wheels whose driver sends messages with errors of scale, noise, slip and wrong stamps."""

    def __init__(self, motion: TrueMotion, variant: Variant) -> None:
        self._motion, self._variant = motion, variant
        self._rng = np.random.default_rng(1)
        self._wheels = WheelOdometry(WheelOdometryConfig(enabled=True), "wheel_odom")
        self._pose, self._sent_s = PlanarPose(0.0, 0.0, 0.0), float(motion.stamps_s[0]) - 1.0

    def add_visual_motion(self, *motion: Any, is_well_constrained: bool) -> None:
        """Compare the wheels with the camera."""
        self._wheels.add_visual_motion(*motion, is_well_constrained=is_well_constrained)

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """The motion by the messages until a frame."""
        while self._sent_s + WHEEL_PERIOD_S <= to_s:
            self._send(self._sent_s + WHEEL_PERIOD_S)
        return self._wheels.motion_between(from_s, to_s)

    def _send(self, stamp_s: float) -> None:
        x_m, y_m, yaw_rad = planar_part(self._motion.between(self._sent_s, stamp_s))
        is_slipping = (stamp_s - self._motion.stamps_s[0]) % SLIP_PERIOD_S < SLIP_S
        scale = TRANSLATION_SCALE * (1.0 + self._variant.slip * is_slipping)
        noise_m, noise_rad = 1e-4 * self._rng.normal(), 2e-4 * self._rng.normal()
        moved = PlanarPose(scale * x_m + noise_m, scale * y_m, ROTATION_SCALE * yaw_rad + noise_rad)
        self._pose, self._sent_s = self._pose.then(moved), stamp_s
        reading = WheelReading(
            stamp_s + self._variant.late_s,
            ("wheel_odom", "base_link"),
            self._pose,
            moved.velocity(WHEEL_PERIOD_S),
        )
        self._wheels.add_message(encode_wheel_reading(reading))


@option("folder", type=Path, help="folder of the sequences")
@option("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
@option("--recordings", nargs="*", type=Path, default=(), help="TUM folders with good views")
def main(args: argparse.Namespace) -> None:
    """Track the scenes with what is known of the base: a table with one row for each.

    Recordings are tracked from several first frames, without and with the odometry of a base that
    moves in all directions.

    "beyond 3 sigmas" counts the frames with a pose whose error exceeds three of its standard
    deviations, in position. FOLDER stores the sequences, which are rendered the first time. ATE and
    largest error are in millimeters.
    """
    folders = render_all(args.folder, {name: read_scene(name) for name in args.scenes})
    warm_up("direct", lambda stage: None)
    print(TABLE.head)
    for name in args.scenes:
        for label, variant in (HAND_HELD if name == "wall" else ROBOT).items():
            print(
                track_variant(f"{name}: {label}", folders[name], SCENES[name], variant),
                flush=True,
            )
    for recording, first in product(args.recordings, FIRST_FRAMES):
        for label, variant in HAND_HELD.items():
            row = f"{recording.name}, from {first}: {label}"
            print(track_variant(row, recording, T_BODY_CAMERA, variant, first), flush=True)


def track_variant(
    label: str, folder: Path, T_base_camera: Array, variant: Variant, first: int = 0
) -> str:
    """Track a sequence from its frame `first` on; return a line of the table."""
    with open_frames_with_truth(folder) as (all_frames, truth):
        motion, wheels = TrueMotion(truth, T_base_camera), None
        if variant.has_wheels:
            is_hand_held = T_base_camera is T_BODY_CAMERA
            wheels = HandOdometry(motion) if is_hand_held else SimulatedWheels(motion, variant)
        odom_frame = OdomFrame(T_base_camera, variant.is_planar, wheels)
        frames = (replace(frame, gravity_m_s2=None) for frame in islice(all_frames, first, None))
        tracked = track("direct", frames, odom_frame)
    each = evaluate_accuracy(tracked, truth)
    return TABLE.row(
        label,
        *(each.frames, each.degraded, each.lost, each.resets),
        *(each.ate_m, each.max_error_m, each.overconfident, each.median_ms),
    )
