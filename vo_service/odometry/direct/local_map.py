"""Local map of the last keyframes, and how much of each is in view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.parameters import MAX_KEYFRAMES, MIN_DEPTH_M, NUM_FINE_LEVELS
from vo_service.odometry.direct.rolling_shutter import project
from vo_service.odometry.direct.se3 import transform_point
from vo_service.odometry.gray_frame import GrayFrame


@dataclass(frozen=True, eq=False)
class DirectKeyframe:
    """A frame that others are aligned with.

    Attributes:
        points: (N, COLUMNS) of each level, in its camera's axes at its stamp.
        images: Its image pyramid.
        T_world_keyframe: 4x4 pose.
        motion: (9,) of its camera in its own axes, see `rolling_shutter`.
        frame: For features; without color, to save memory.
    """

    points: tuple[Array, ...]
    images: ImagePyramid
    T_world_keyframe: Array
    motion: Array
    frame: GrayFrame


def make_keyframe(
    frame: RgbdFrame | GrayFrame,
    images: ImagePyramid,
    T_world_keyframe: Array,
    motion: Array,
    is_static: NDArray[np.bool_],
) -> DirectKeyframe:
    """Make a keyframe of a frame with known pose and motion; see `select_points`."""
    points = select_points(images, motion, is_static)
    return DirectKeyframe(points, images, T_world_keyframe, motion, GrayFrame.of(frame))


@dataclass(frozen=True)
class KeyframeOverlap:
    """Overlap of a keyframe with a camera's view.

    Attributes:
        share: Of its points that lie in the image, 0 to 1.
        flow_px: Root mean square of their displacement, in pixels of the whole image.
    """

    share: float
    flow_px: float


class LocalMap:
    """The last keyframes of one world frame, the most recently used one last."""

    def __init__(self) -> None:
        self.keyframes: list[DirectKeyframe] = []

    def reset(self, keyframe: DirectKeyframe) -> None:
        """Drop all keyframes and start with this one."""
        self.keyframes = [keyframe]

    def add(self, keyframe: DirectKeyframe) -> None:
        """Add a keyframe; the least recently used one is dropped."""
        self.keyframes = [*self.keyframes, keyframe][-MAX_KEYFRAMES:]

    def move_to_newest(self, keyframe: DirectKeyframe) -> None:
        """Mark a keyframe as the most recently used one."""
        self.keyframes = [each for each in self.keyframes if each is not keyframe]
        self.add(keyframe)

    def rank_by_overlap(
        self, T_world_camera: Array
    ) -> list[tuple[DirectKeyframe, KeyframeOverlap]]:
        """All keyframes with their overlap, the largest share first."""
        T_camera_world = inverse(T_world_camera)
        overlaps = [
            (k, compute_overlap(k, T_camera_world @ k.T_world_keyframe)) for k in self.keyframes
        ]
        return sorted(overlaps, key=lambda pair: -pair[1].share)


def compute_overlap(keyframe: DirectKeyframe, T_camera_keyframe: Array) -> KeyframeOverlap:
    """Overlap of a keyframe with the view of the same camera at another pose."""
    # The finest of the coarse levels has few points, but enough.
    level = min(NUM_FINE_LEVELS, len(keyframe.points) - 1)
    camera = keyframe.images.camera
    size = np.array([camera.width, camera.height], np.float64)
    in_view, squared = _measure_flow(
        keyframe.points[level], T_camera_keyframe, keyframe.images.intrinsics[0], size
    )
    return KeyframeOverlap(in_view / max(len(keyframe.points[level]), 1), float(np.sqrt(squared)))


@kernel
def _measure_flow(points: Array, T: Array, intrinsics: Array, size: Array) -> tuple[int, float]:
    """Number of points in the image, and their mean squared displacement, px^2."""
    in_view, total = 0, 0.0
    for n in range(len(points)):
        x, y, z = transform_point(T, points[n, 0], points[n, 1], points[n, 2])
        if z < MIN_DEPTH_M:
            continue
        u, v = project(x, y, z, intrinsics)
        if not (0.0 <= u < size[0] and 0.0 <= v < size[1]):
            continue
        in_view += 1
        before_u, before_v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        total += (u - before_u) ** 2 + (v - before_v) ** 2
    return in_view, total / max(in_view, 1)
