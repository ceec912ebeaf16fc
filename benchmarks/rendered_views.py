"""Frames of the virtual Kinect: along tours, at chosen views, and what two views share."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.tracking import read_all_frames
from drivers.camera import PinholeCamera, PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, inverse, rigid_transform, transform_points
from drivers.recording_camera import RecordingCamera
from drivers.synthetic import MotionKind, SyntheticConfig
from drivers.synthetic.camera_motion import CameraMotion, look_rotations, rotations_from_vectors
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import Renderer, RoomModel, make_renderer
from drivers.synthetic.room import ROOM_HEIGHT_M
from drivers.synthetic.sensors import RenderedImages
from vo_service.odometry.direct.motion import se3_exp, se3_log

THREADS = 2
PREFETCH_COUNT = 6
T = TypeVar("T")
# Stride of the grid of pixels that represents a view.
STEP_PX = 32
# A point is visible in another view if its depth there agrees within this distance.
MAX_SAME_DISTANCE_M = 0.10
# Each spot of a room has a first view, and others at these distances (m) and angles (degrees).
VIEW_OFFSETS = ((0.1, 5.0), (0.2, 10.0), (0.3, 20.0), (0.45, 30.0), (0.6, 40.0))
SPOTS_PER_ROOM = 6
# Speeds of the hand during a view, m/s and rad/s along each axis.
SPEEDS = np.repeat([0.15, 0.25], 3)
# Time between views of a recording.
VIEW_PERIOD_S = 0.5


def make_frame(
    config: SyntheticConfig, seq: int, stamp_s: float, images: RenderedImages
) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images; it arrives at its stamp.

    Args:
        config: The virtual Kinect.
        seq: Number of the frame.
        stamp_s: Its stamp, s.
        images: Its color and depth.
    """
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=images.color_bgr,
        depth_raw=images.depth_raw,
        depth_factor=config.depth_factor,
        camera=config.camera,
        skew_s=config.timing.skew_s,
        readout_s=config.timing.readout_s,
    )


def prefetch(make: Callable[[int], T], count: int) -> Iterator[T]:
    """Yield `make` of 0 to `count` - 1 in order; threads make the next few ahead."""
    with ThreadPoolExecutor(THREADS) as pool:
        made: deque[Future[T]] = deque()
        try:
            for number in range(count):
                made.append(pool.submit(make, number))
                if len(made) > PREFETCH_COUNT:
                    yield made.popleft().result()
            while made:
                yield made.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def make_tour_config(seed: int, seconds: float, aliased_corners: bool) -> SyntheticConfig:
    """Make the configuration of a tour with noise, depth quantization and rolling shutter.

    Motion blur and smooth edges are off, because they are slow to render.

    Args:
        seed: Seed of the room.
        seconds: Length, s.
        aliased_corners: Whether two corners of the room look the same.
    """
    config = SyntheticConfig(
        seed=seed,
        duration_s=seconds,
        motion=MotionKind.TOUR,
        twin_corners=aliased_corners,
        texel_m=0.003,
    )
    return replace(config, color=replace(config.color, exposure_s=0.0, smooth_edges=False))


def compute_true_poses(config: SyntheticConfig) -> Array:
    """True poses T_room_camera (N, 4, 4) of all frames."""
    times_s = np.arange(config.frame_count) / config.rate_hz
    return make_motion(config, ROOM_HEIGHT_M).poses(times_s)


def render_frames(config: SyntheticConfig) -> Iterator[RgbdFrame]:
    """Yield all frames in order; two threads render a few ahead."""
    renderer = make_renderer(config, THREADS)
    for seq, images in enumerate(prefetch(renderer.render, config.frame_count)):
        yield make_tour_frame(config, seq, images)


def make_tour_frame(config: SyntheticConfig, seq: int, images: RenderedImages) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images, with a stamp in microseconds.

    Args:
        config: The tour.
        seq: Number of the frame.
        images: Its color and depth.
    """
    return make_frame(config, seq, round(seq / config.rate_hz, 6), images)


@dataclass(frozen=True)
class ObservedView:
    """Points (N, 3) in the room at a grid of pixels, and the camera.

    `depth_m` is the whole image (H, W) as float16, 0 = no reading.
    """

    camera: PinholeCamera
    T_room_camera: Array
    points_m: Array
    depth_m: NDArray[np.float16]

    @classmethod
    def from_frame(cls, frame: RgbdFrame, T_room_camera: Array) -> "ObservedView":
        """Make the view of a frame with a known pose."""
        camera, half = frame.camera, STEP_PX // 2
        v, u = np.mgrid[half : camera.height : STEP_PX, half : camera.width : STEP_PX]
        z = frame.depth_m[v, u].astype(np.float64)
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(z)])
        points_m = (rays * z)[:, z > 0].T
        return cls(
            camera,
            T_room_camera,
            transform_points(T_room_camera, points_m),
            frame.depth_m.astype(np.float16),
        )

    def overlap_with(self, other: "ObservedView") -> float:
        """Fraction of the other view's points that are visible in this view."""
        if not len(other.points_m):
            return 0.0
        x, y, z = transform_points(inverse(self.T_room_camera), other.points_m).T
        ahead = np.maximum(z, 1e-6)
        u = np.rint(self.camera.fx * x / ahead + self.camera.cx).astype(int)
        v = np.rint(self.camera.fy * y / ahead + self.camera.cy).astype(int)
        height, width = self.depth_m.shape
        inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        there_m = self.depth_m[v[inside], u[inside]].astype(np.float64)
        is_same = (there_m > 0) & (np.abs(there_m - z[inside]) < MAX_SAME_DISTANCE_M)
        return float(np.count_nonzero(is_same)) / len(other.points_m)


def max_overlap(view: ObservedView, before: Sequence[ObservedView]) -> float:
    """Largest overlap of a view with one of the views before."""
    return max((one.overlap_with(view) for one in before), default=0.0)


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
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
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
