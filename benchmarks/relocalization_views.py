"""Single views with their poses, of rooms of the virtual Kinect and of recordings."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.camera_frames import read_all_frames
from benchmarks.virtual_frames import make_frame
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.errors import InputError
from drivers.core.geometry import Array, inverse, rigid_transform
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motion.base import CameraMotion, look_rotations, rotations_from_vectors
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.tum.camera import TumCamera
from vo_service.odometry.direct.motion import se3_exp, se3_log

# Each spot of a room has a first view, and others at these distances (m) and angles (degrees).
VIEW_OFFSETS = ((0.1, 5.0), (0.2, 10.0), (0.3, 20.0), (0.45, 30.0), (0.6, 40.0))
SPOTS_PER_ROOM = 6
# Speeds of the hand during a view, m/s and rad/s along each axis.
SPEEDS = np.repeat([0.15, 0.25], 3)
# Time between views of a recording.
VIEW_PERIOD_S = 0.5


@dataclass(frozen=True)
class PosedView:
    """A frame with the pose and velocity of the camera.

    Attributes:
        scene: Room or recording; poses of two scenes cannot be compared.
        frame: The frame.
        T_world_camera: Pose of the camera (4, 4) in the scene.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
    """

    scene: str
    frame: RgbdFrame
    T_world_camera: Array
    velocity: Array


class PiecewiseMotion(CameraMotion):
    """A camera that is near one pose for each frame, with a velocity."""

    def __init__(self, poses: list[Array], velocities: list[Array], rate_hz: float) -> None:
        self._poses, self._velocities, self._rate_hz = poses, velocities, rate_hz

    def poses(self, times_s: Array) -> Array:
        frames = np.clip(np.rint(times_s * self._rate_hz), 0, len(self._poses) - 1).astype(int)
        delays_s = times_s - frames / self._rate_hz
        return np.array(
            [
                self._poses[n] @ se3_exp(delay_s * self._velocities[n])
                for n, delay_s in zip(frames, delays_s, strict=True)
            ]
        )

    def clearance_points_m(self, times_s: Array) -> Array:
        return np.array(self._poses)[:, :3, 3]


def views_of_room(seed: int) -> Iterator[PosedView]:
    """Yield views of a furnished room from a moving hand."""
    rng = np.random.default_rng([seed, 77])
    poses = [pose for _ in range(SPOTS_PER_ROOM) for pose in poses_around(_random_pose(rng), rng)]
    velocities = [SPEEDS * rng.normal(size=6) for _ in poses]
    rate_hz = SyntheticConfig.rate_hz
    config = SyntheticConfig(seed=seed, duration_s=len(poses) / rate_hz)
    motion = PiecewiseMotion(poses, velocities, rate_hz)
    renderer = Renderer(config, motion, RoomModel.build(config, motion, 1))
    for seq, (T_world_camera, velocity) in enumerate(zip(poses, velocities, strict=True)):
        images = renderer.render(seq)
        frame = make_frame(config, seq, seq / rate_hz, images)
        yield PosedView(f"room {seed}", frame, T_world_camera, velocity)


def _random_pose(rng: np.random.Generator) -> Array:
    """A random pose in the room, looking in any direction, a little down."""
    yaw, down, roll = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.45), rng.normal(0.0, 0.05)
    R = look_rotations(np.array([yaw]), np.array([down]), np.array([roll]))[0]
    return rigid_transform(R, rng.uniform([-1.3, -1.0, 1.0], [1.3, 1.0, 1.6]))


def poses_around(T_world_spot: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the pose, then poses at the distances and angles of VIEW_OFFSETS, mostly level."""
    yield T_world_spot
    for distance_m, degrees in VIEW_OFFSETS:
        axis, direction = rng.normal(size=3) * (0.5, 1.0, 0.3), rng.normal(size=3) * (1.0, 0.3, 1.0)
        R = rotations_from_vectors(np.radians(degrees) * axis[None] / np.linalg.norm(axis))[0]
        yield T_world_spot @ rigid_transform(R, distance_m * direction / np.linalg.norm(direction))


def views_of_recording(folder: Path) -> Iterator[PosedView]:
    """Yield the views of a recording. Raises InputError without a ground truth."""
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        truth = camera.ground_truth
        if truth is None:
            raise InputError(f"{folder}: has no groundtruth.txt; name a recording with one")
        next_s = -np.inf
        for frame in read_all_frames(camera):
            n = int(np.searchsorted(truth.stamps_s, frame.stamp_s - 1e-4))
            if frame.stamp_s < next_s or not 0 < n < len(truth) - 1:
                continue
            next_s = frame.stamp_s + VIEW_PERIOD_S
            T = truth.T_world_camera
            duration_s = truth.stamps_s[n + 1] - truth.stamps_s[n - 1]
            velocity = se3_log(inverse(T[n - 1]) @ T[n + 1]) / duration_s
            yield PosedView(folder.name, frame, T[n], velocity)
