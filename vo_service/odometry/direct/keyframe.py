"""Keyframes: the local map, and how much of each keyframe is in view."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.motion import project, transform_point
from vo_service.odometry.direct.parameters import (
    MAX_KEYFRAMES,
    MIN_DEPTH_M,
    NUM_FINE_LEVELS,
)
from vo_service.odometry.direct.points import Points, select_points
from vo_service.odometry.features.gray_frame import GrayFrame


@dataclass(frozen=True, eq=False)
class DirectKeyframe:
    """A frame that others are aligned with.

    Attributes:
        points: Of each level.
        images: Its image pyramid.
        T_world_keyframe: 4x4 pose.
        motion: (9,) of its camera in its own axes, see `motion`.
        frame: For features; without color, to save memory.
    """

    points: tuple[Points, ...]
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
    """Make a keyframe of a frame with known pose and motion; see `select_points`.

    Args:
        frame: The frame.
        images: Its image pyramid.
        T_world_keyframe: 4x4 pose.
        motion: (9,) of its camera in its own axes.
        is_static: (CELLS,) which cells of the image to take points from.
    """
    points = select_points(images, motion, is_static)
    images = replace(images, depth=images.depth.without_inverse())
    return DirectKeyframe(points, images, T_world_keyframe, motion, GrayFrame.of(frame))


@dataclass(frozen=True)
class KeyframeOverlap:
    """Overlap of a keyframe with a camera's view.

    Attributes:
        share: Of its points that lie in the image, 0 to 1.
        flow: Root mean square of their displacement, as a share of the longer side of the image.
    """

    share: float
    flow: float


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
        keyframe.points[level].position_m, T_camera_keyframe, keyframe.images.intrinsics[0], size
    )
    flow = float(np.sqrt(squared) / size.max())
    return KeyframeOverlap(in_view / max(len(keyframe.points[level].brightness), 1), flow)


@kernel
def _measure_flow(position_m: Array, T: Array, intrinsics: Array, size: Array) -> tuple[int, float]:
    """Number of points in the image, and their mean squared displacement, px^2."""
    in_view, total = 0, 0.0
    for n in range(position_m.shape[1]):
        x, y, z = transform_point(T, position_m[0, n], position_m[1, n], position_m[2, n])
        if z < MIN_DEPTH_M:
            continue
        u, v = project(x, y, z, intrinsics)
        if not (0.0 <= u < size[0] and 0.0 <= v < size[1]):
            continue
        in_view += 1
        before_u, before_v = project(
            position_m[0, n], position_m[1, n], position_m[2, n], intrinsics
        )
        total += (u - before_u) ** 2 + (v - before_v) ** 2
    return in_view, total / max(in_view, 1)
