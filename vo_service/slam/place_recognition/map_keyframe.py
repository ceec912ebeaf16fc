"""A place: what is kept of a view, to know it again for as long as the map lasts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.odometry.direct.keyframe_points import POINT_BRIGHTNESS
from vo_service.slam.place_recognition.depth_features import DepthFeatures

# Of the levels with more points than this, every second one is kept: the error grows by a
# fifteenth, the memory and the time of an alignment fall by two fifths.
DECIMATION_MIN_POINTS = 700
# The largest number of half precision, and a little less.
MAX_FLOAT16 = 65000.0


@dataclass(frozen=True, eq=False)
class PackedPoints:
    """The points of a keyframe's level, see `keyframe.points`, in a third of their memory.

    position_m  (N, 3) float32
    rest        (N, COLUMNS - 3) float16: brightness exactly, slopes to a thousandth
    """

    position_m: NDArray[np.float32]
    attributes: NDArray[np.float16]

    @classmethod
    def pack(cls, points: Array) -> Self:
        """Pack (N, COLUMNS); of many every second one."""
        kept = points[:: 2 if len(points) > DECIMATION_MIN_POINTS else 1]
        rest = np.clip(kept[:, POINT_BRIGHTNESS:], -MAX_FLOAT16, MAX_FLOAT16)
        return cls(kept[:, :POINT_BRIGHTNESS].astype(np.float32), rest.astype(np.float16))

    def unpack(self) -> Array:
        """(N, COLUMNS) float64."""
        return np.hstack([self.position_m, self.attributes], dtype=np.float64)

    @property
    def size_bytes(self) -> int:
        """What they take."""
        return self.position_m.nbytes + self.attributes.nbytes


@dataclass(frozen=True, eq=False)
class MapKeyframe:
    """A view that the map knows again.

    number           rises; never used twice in a map
    world            the stretch of odometry that it was seen in
    stamp_s          of the frame
    T_world_place    4x4, where the odometry said that the camera was
    camera           intrinsics of the frame
    landmarks        in the camera's axes at the stamp
    summary          (D,) int8, see `words`
    packed_points    of each level, for the dense alignment
    mean_brightness  of the whole image, gray levels
    """

    number: int
    world_id: int
    stamp_s: float
    T_world_keyframe: Array
    camera: PinholeCamera
    features: DepthFeatures
    vlad_descriptor: NDArray[np.int8]
    packed_points: tuple[PackedPoints, ...]
    mean_brightness: float

    @property
    def alignment_points(self) -> Sequence[Array]:
        """(N, COLUMNS) of each level, in the camera's axes at the stamp."""
        return tuple(points.unpack() for points in self.packed_points)

    @property
    def size_bytes(self) -> int:
        """What it takes, but for a few hundred."""
        points = sum(points.size_bytes for points in self.packed_points)
        return points + self.features.size_bytes + self.vlad_descriptor.nbytes
