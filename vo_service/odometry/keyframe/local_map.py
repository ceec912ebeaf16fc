"""The keyframes around the camera: which of them are in view, and how far they have moved in it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from drivers.jit import kernel
from vo_service.odometry.grey_frame import GreyFrame
from vo_service.odometry.keyframe.images import FINE_LEVELS, Images
from vo_service.odometry.keyframe.parameters import KEYFRAMES
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.keyframe.readings import NEAREST_M
from vo_service.odometry.keyframe.rows import project
from vo_service.odometry.keyframe.twists import transformed

*_, MOST_KEYFRAMES = KEYFRAMES


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame that others are laid on.

    points            (N, COLUMNS) of each level, in its camera's axes at its stamp
    T_world_keyframe  4x4
    movement          (9,) of its camera in its own axes, see `movement`
    frame             for features, where those are needed; without colour, for there are many
    """

    points: tuple[Array, ...]
    images: Images
    T_world_keyframe: Array
    movement: Array
    frame: GreyFrame


def make_keyframe(
    frame: RgbdFrame | GreyFrame,
    images: Images,
    T_world_keyframe: Array,
    movement: Array,
    is_still: NDArray[np.bool_],
) -> Keyframe:
    """A keyframe of a frame whose pose and movement are known; see `find_points`."""
    points = find_points(images, movement, is_still)
    return Keyframe(points, images, T_world_keyframe, movement, GreyFrame.of(frame))


@dataclass(frozen=True)
class Overlap:
    """How much of a keyframe a camera sees.

    share    of its points that lie in the image, 0 to 1
    flow_px  root mean square of how far these have moved, in pixels of the whole image
    """

    share: float
    flow_px: float


class LocalMap:
    """The last keyframes of one world."""

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []

    def begin(self, keyframe: Keyframe) -> None:
        """The first one; those of another world are forgotten."""
        self.keyframes = [keyframe]

    def add(self, keyframe: Keyframe) -> None:
        """The next one; the one that was longest out of use goes."""
        self.keyframes = [*self.keyframes, keyframe][-MOST_KEYFRAMES:]

    def use(self, keyframe: Keyframe) -> None:
        """It is in use again."""
        self.keyframes = [each for each in self.keyframes if each is not keyframe]
        self.add(keyframe)

    def in_view(self, T_world_camera: Array) -> list[tuple[Keyframe, Overlap]]:
        """All of them, the one that the camera sees most of first."""
        T_camera_world = inverse(T_world_camera)
        found = [(k, overlap(k, T_camera_world @ k.T_world_keyframe)) for k in self.keyframes]
        return sorted(found, key=lambda pair: -pair[1].share)


def overlap(keyframe: Keyframe, T_camera_keyframe: Array) -> Overlap:
    """How much of a keyframe the same camera sees from elsewhere."""
    # The finest of the coarse levels: few points, and enough of them.
    level = min(FINE_LEVELS, len(keyframe.points) - 1)
    camera = keyframe.images.camera
    size = np.array([camera.width, camera.height], np.float64)
    seen, squared = _project(
        keyframe.points[level], T_camera_keyframe, keyframe.images.intrinsics[0], size
    )
    return Overlap(seen / max(len(keyframe.points[level]), 1), float(np.sqrt(squared)))


@kernel
def _project(points: Array, T: Array, intrinsics: Array, size: Array) -> tuple[int, float]:
    """How many points lie in the image, and the mean square of how far they have moved."""
    seen, total = 0, 0.0
    for n in range(len(points)):
        x, y, z = transformed(T, points[n, 0], points[n, 1], points[n, 2])
        if z < NEAREST_M:
            continue
        u, v = project(x, y, z, intrinsics)
        if not (0.0 <= u < size[0] and 0.0 <= v < size[1]):
            continue
        seen += 1
        before_u, before_v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        total += (u - before_u) ** 2 + (v - before_v) ** 2
    return seen, total / max(seen, 1)
