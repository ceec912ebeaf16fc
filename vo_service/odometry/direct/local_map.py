"""The keyframes around the camera: which of them are in view, and how far they have moved in it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import NUM_FINE_LEVELS, ImagePyramid
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.parameters import KEYFRAME_COUNTS
from vo_service.odometry.direct.rolling_shutter import project
from vo_service.odometry.direct.se3 import transform_point
from vo_service.odometry.direct.warping import MIN_DEPTH_M
from vo_service.odometry.gray_frame import GrayFrame

*_, MAX_KEYFRAMES = KEYFRAME_COUNTS


@dataclass(frozen=True, eq=False)
class DirectKeyframe:
    """A frame that others are laid on.

    points            (N, COLUMNS) of each level, in its camera's axes at its stamp
    T_world_keyframe  4x4
    movement          (9,) of its camera in its own axes, see `movement`
    frame             for features, where those are needed; without color, for there are many
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
    """A keyframe of a frame whose pose and movement are known; see `select_points`."""
    points = select_points(images, motion, is_static)
    return DirectKeyframe(points, images, T_world_keyframe, motion, GrayFrame.of(frame))


@dataclass(frozen=True)
class KeyframeOverlap:
    """How much of a keyframe a camera sees.

    share    of its points that lie in the image, 0 to 1
    flow_px  root mean square of how far these have moved, in pixels of the whole image
    """

    share: float
    flow_px: float


class LocalMap:
    """The last keyframes of one world."""

    def __init__(self) -> None:
        self.keyframes: list[DirectKeyframe] = []

    def reset(self, keyframe: DirectKeyframe) -> None:
        """The first one; those of another world are forgotten."""
        self.keyframes = [keyframe]

    def add(self, keyframe: DirectKeyframe) -> None:
        """The next one; the one that was longest out of use goes."""
        self.keyframes = [*self.keyframes, keyframe][-MAX_KEYFRAMES:]

    def move_to_newest(self, keyframe: DirectKeyframe) -> None:
        """It is in use again."""
        self.keyframes = [each for each in self.keyframes if each is not keyframe]
        self.add(keyframe)

    def rank_by_overlap(
        self, T_world_camera: Array
    ) -> list[tuple[DirectKeyframe, KeyframeOverlap]]:
        """All of them, the one that the camera sees most of first."""
        T_camera_world = inverse(T_world_camera)
        found = [
            (k, compute_overlap(k, T_camera_world @ k.T_world_keyframe)) for k in self.keyframes
        ]
        return sorted(found, key=lambda pair: -pair[1].share)


def compute_overlap(keyframe: DirectKeyframe, T_camera_keyframe: Array) -> KeyframeOverlap:
    """How much of a keyframe the same camera sees from elsewhere."""
    # The finest of the coarse levels: few points, and enough of them.
    level = min(NUM_FINE_LEVELS, len(keyframe.points) - 1)
    camera = keyframe.images.camera
    size = np.array([camera.width, camera.height], np.float64)
    seen, squared = _measure_flow(
        keyframe.points[level], T_camera_keyframe, keyframe.images.intrinsics[0], size
    )
    return KeyframeOverlap(seen / max(len(keyframe.points[level]), 1), float(np.sqrt(squared)))


@kernel
def _measure_flow(points: Array, T: Array, intrinsics: Array, size: Array) -> tuple[int, float]:
    """How many points lie in the image, and the mean square of how far they have moved."""
    seen, total = 0, 0.0
    for n in range(len(points)):
        x, y, z = transform_point(T, points[n, 0], points[n, 1], points[n, 2])
        if z < MIN_DEPTH_M:
            continue
        u, v = project(x, y, z, intrinsics)
        if not (0.0 <= u < size[0] and 0.0 <= v < size[1]):
            continue
        seen += 1
        before_u, before_v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        total += (u - before_u) ** 2 + (v - before_v) ** 2
    return seen, total / max(seen, 1)
