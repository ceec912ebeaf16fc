"""Keyframe of a map: the compact data of a view for its recognition."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.odometry.direct.keyframe_points import POINT_BRIGHTNESS
from vo_service.slam.place_recognition.depth_features import DepthFeatures

# Levels with more points keep every second one: the error grows by 1/15, memory and time of an
# alignment fall by 2/5.
DECIMATION_MIN_POINTS = 700
# Slightly less than the largest number of half precision.
MAX_FLOAT16 = 65000.0


@dataclass(frozen=True, eq=False)
class PackedPoints:
    """Points of a keyframe's level, see `keyframe_points`, in a third of their memory.

    Attributes:
        position_m: (N, 3) float32.
        attributes: (N, COLUMNS - 3) float16: brightness exactly, slopes to a thousandth.
    """

    position_m: NDArray[np.float32]
    attributes: NDArray[np.float16]

    @classmethod
    def pack(cls, points: Array) -> Self:
        """Pack points (N, COLUMNS); of many every second one."""
        selected = points[:: 2 if len(points) > DECIMATION_MIN_POINTS else 1]
        attributes = np.clip(selected[:, POINT_BRIGHTNESS:], -MAX_FLOAT16, MAX_FLOAT16)
        return cls(selected[:, :POINT_BRIGHTNESS].astype(np.float32), attributes.astype(np.float16))

    def unpack(self) -> Array:
        """Unpack to (N, COLUMNS) float64."""
        return np.hstack([self.position_m, self.attributes], dtype=np.float64)

    @property
    def size_bytes(self) -> int:
        """Memory of the arrays."""
        return self.position_m.nbytes + self.attributes.nbytes


@dataclass(frozen=True, eq=False)
class MapKeyframe:
    """A keyframe of a map.

    Attributes:
        number: Ascending; never used twice in a map.
        world_id: World frame of the odometry.
        stamp_s: Of the frame.
        T_world_keyframe: 4x4 pose by the odometry.
        camera: Intrinsics of the frame.
        features: In the camera's axes at the stamp.
        vlad_descriptor: (D,) int8, see `VladVocabulary`.
        packed_points: Of each level, for the dense alignment.
        mean_brightness: Of the whole image, gray levels.
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
        """Memory of its arrays."""
        points = sum(points.size_bytes for points in self.packed_points)
        return points + self.features.size_bytes + self.vlad_descriptor.nbytes
