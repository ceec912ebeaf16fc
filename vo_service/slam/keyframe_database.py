"""The keyframes of the map, the features of their views, and their database.

VLAD describes a view: Jegou, Douze, Schmid and Perez, "Aggregating local descriptors into a compact
image representation" (CVPR 2010), with each word's sum normalized (Arandjelovic and Zisserman, "All
about VLAD", CVPR 2013).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.aligner import MovingView
from vo_service.odometry.direct.motion import (
    constant_velocity_motion,
    propagate_motion,
    propagate_point,
    row_time,
)
from vo_service.odometry.direct.points import Points
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.points import FeaturePoints, backproject_features
from vo_service.odometry.uncertainty import depth_sigma_m, lateral_sigma_m


@dataclass(frozen=True, eq=False)
class DepthFeatures:
    """SURF features with 3-D points, strongest first.

    Attributes:
        descriptor_int8: (N, 64) int8 whole numbers; the few beyond 127 are clipped.
        sign: (N,) int8 of the Laplacian: +1 dark blob, -1 bright blob.
        position_m: (N, 3) float32 in the camera's axes at the stamp.
    """

    descriptor_int8: NDArray[np.int8]
    sign: NDArray[np.int8]
    position_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.descriptor_int8)

    @property
    def descriptor(self) -> NDArray[np.float32]:
        """(N, 64) float32, for matching."""
        return self.descriptor_int8.astype(np.float32)

    @property
    def size_bytes(self) -> int:
        """Memory of the arrays."""
        return self.descriptor_int8.nbytes + self.sign.nbytes + self.position_m.nbytes

    def to_feature_points(self, focal_px: float) -> FeaturePoints:
        """Convert to points with their standard deviations."""
        depth_m = self.position_m[:, 2].astype(np.float64)
        return FeaturePoints(
            position_m=self.position_m.astype(np.float64),
            has_depth=np.ones(len(self), np.bool_),
            sigma_across_m=lateral_sigma_m(depth_m, focal_px),
            sigma_along_m=depth_sigma_m(depth_m),
        )


def extract_depth_features(
    frame: RgbdFrame, extractor: SurfExtractor, velocity: Array, max_features: int
) -> DepthFeatures:
    """Extract the strongest features with depth.

    Args:
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s; it corrects each row for
            its time.
    """
    features = extractor.extract(frame.gray)
    points = backproject_features(features, frame)
    selected = np.flatnonzero(points.has_depth)[:max_features]
    position_m = compensate_rolling_shutter(
        points.position_m[selected],
        features.position_px[selected, 1].astype(np.float64),
        frame.camera.height,
        frame.readout_s,
        constant_velocity_motion(velocity),
    )
    return DepthFeatures(
        descriptor_int8=np.clip(features.descriptor[selected], -127, 127).astype(np.int8),
        sign=features.sign[selected].astype(np.int8),
        position_m=position_m.astype(np.float32),
    )


@kernel
def compensate_rolling_shutter(
    position_m: Array, row_px: Array, height: int, readout_s: float, motion: Array
) -> Array:
    """Transform points (N, 3), observed in rows (N,), to the time of the middle row.

    motion is (9,) of the camera in its own axes, see `motion`.

    Args:
        position_m: (N, 3) points in camera axes at the time of their row, m.
        row_px: (N,) rows in which they were observed.
        height: Rows of the image.
        readout_s: Time from the first row to the last, s.
        motion: (9,) motion of the camera in its own axes.
    """
    compensated = np.empty_like(position_m)
    for n in range(len(position_m)):
        x, y, z = position_m[n]
        tau = row_time(row_px[n], height, readout_s)
        compensated[n, 0], compensated[n, 1], compensated[n, 2] = propagate_point(
            propagate_motion(motion, tau), x, y, z, -tau
        )
    return compensated


# Descriptors are whole numbers with this norm: their products are exact in float32 in any order of
# summation.
DESCRIPTOR_NORM = 1000.0


@dataclass(frozen=True, eq=False)
class VladVocabulary:
    """Visual words, cluster centers (K, 64) of SURF descriptors: float32 whole numbers."""

    cluster_centers: NDArray[np.float32]

    @classmethod
    def default(cls) -> Self:
        """Load the packaged vocabulary, made by `python -m benchmarks place_recognition train`."""
        with files(__package__).joinpath("vlad_vocabulary.npy").open("rb") as file:
            return cls(np.load(file, allow_pickle=False).astype(np.float32))

    def describe(self, descriptors: NDArray[np.generic]) -> NDArray[np.int8]:
        """Aggregate descriptors (N, 64) to a VLAD descriptor (K * 64,) int8.

        The similarity of two views is the product of their VLAD descriptors.
        """
        features = descriptors.astype(np.float32)
        nearest = self.assign_words(features)
        sums = np.zeros(self.cluster_centers.shape, np.float32)
        np.add.at(sums, nearest, features - self.cluster_centers[nearest])
        normalized = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1.0)
        scaled = normalized.ravel() * (
            DESCRIPTOR_NORM / max(float(np.linalg.norm(normalized)), 1e-9)
        )
        descriptor: NDArray[np.int8] = np.clip(np.rint(scaled), -127, 127).astype(np.int8)
        return descriptor

    def assign_words(self, features: NDArray[np.float32]) -> NDArray[np.intp]:
        """(N,) index of the nearest word of each feature (N, 64)."""
        half_squares = 0.5 * np.einsum("kd,kd->k", self.cluster_centers, self.cluster_centers)
        similarity: NDArray[np.float32] = features @ self.cluster_centers.T - half_squares
        return np.asarray(similarity.argmax(axis=1), np.intp)


# Levels with more points keep every second one: the error grows by 1/15, memory and time of an
# alignment fall by 2/5.
DECIMATION_MIN_POINTS = 700
# Fields of a point beside its position.
NUM_POINT_ATTRIBUTES = 10
# Slightly less than the largest number of half precision.
MAX_FLOAT16 = 65000.0


@dataclass(frozen=True, eq=False)
class PackedPoints:
    """Points of a keyframe's level, see `points`, in a third of their memory.

    Attributes:
        position_m: (N, 3) float32.
        attributes: (N, ATTRIBUTES) float16: the other fields of `Points`, the brightness exactly,
            gradients to a thousandth.
    """

    position_m: NDArray[np.float32]
    attributes: NDArray[np.float16]

    @classmethod
    def pack(cls, points: Points) -> Self:
        """Pack points; of many every second one."""
        step = 2 if len(points.brightness) > DECIMATION_MIN_POINTS else 1
        position_m, *others = points.select(slice(None, None, step))
        attributes = np.clip(np.vstack(others).T, -MAX_FLOAT16, MAX_FLOAT16)
        return cls(position_m.T.astype(np.float32), attributes.astype(np.float16))

    def unpack(self) -> Points:
        """Return the points, with rounded values."""
        brightness, variance, *gradients, has_texture, has_shape = self.attributes.T
        return Points(
            np.ascontiguousarray(self.position_m.T, np.float64),
            brightness.astype(np.float64),
            variance.astype(np.float64),
            np.array(gradients[:3], np.float64),
            np.array(gradients[3:], np.float64),
            has_texture > 0,
            has_shape > 0,
        )

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
    def alignment_points(self) -> Sequence[Points]:
        """Points of each level."""
        return tuple(points.unpack() for points in self.packed_points)

    @property
    def size_bytes(self) -> int:
        """Memory of its arrays."""
        points = sum(points.size_bytes for points in self.packed_points)
        return points + self.features.size_bytes + self.vlad_descriptor.nbytes


# Sigma of the camera's velocity, m/s and rad/s: if the odometry tracked the frame, and if it was
# lost.
TRACKED_VELOCITY_SIGMA, LOST_VELOCITY_SIGMA = (0.01, 0.03), (0.3, 1.0)


@dataclass(frozen=True, eq=False)
class QueryFrame:
    """A frame to be recognized, or to become a keyframe.

    Attributes:
        features: In the camera's axes at the stamp.
        vlad_descriptor: (D,) int8, see `VladVocabulary`.
        view: For the dense alignment.
    """

    features: DepthFeatures
    vlad_descriptor: NDArray[np.int8]
    view: MovingView

    @property
    def stamp_s(self) -> float:
        return self.view.images.stamp_s

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics of the frame."""
        return self.view.images.camera


class KeyframeDatabase:
    """Keyframes by their ascending numbers.

    Args:
        max_bytes: Capacity.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._keyframes: dict[int, MapKeyframe] = {}
        self._size_bytes = 0

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[MapKeyframe]:
        return iter(self._keyframes.values())

    def __getitem__(self, number: int) -> MapKeyframe:
        return self._keyframes[number]

    def __contains__(self, number: int) -> bool:
        return number in self._keyframes

    @property
    def size_bytes(self) -> int:
        """Memory of all keyframes."""
        return self._size_bytes

    @property
    def is_over_capacity(self) -> bool:
        """Whether the keyframes take more memory than the capacity."""
        return self._size_bytes > self._max_bytes

    def add(self, keyframe: MapKeyframe) -> None:
        """Add a keyframe with a higher number than all others."""
        if self._keyframes and keyframe.number <= next(reversed(self._keyframes)):
            raise ValueError(f"keyframe {keyframe.number} is not newer than the others")
        self._keyframes[keyframe.number] = keyframe
        self._size_bytes += keyframe.size_bytes

    def remove(self, number: int) -> None:
        """Remove a keyframe.

        Raises:
            KeyError: If there is none with this number.
        """
        self._size_bytes -= self._keyframes.pop(number).size_bytes

    def find_similar(
        self, query: QueryFrame, count: int, is_allowed: Callable[[MapKeyframe], bool]
    ) -> list[MapKeyframe]:
        """Find the allowed keyframes that look most like a view, the most similar first.

        Args:
            is_allowed: Whether a keyframe may be found.
        """
        keyframes = [keyframe for keyframe in self if is_allowed(keyframe)]
        if not keyframes:
            return []
        descriptors = np.stack([keyframe.vlad_descriptor for keyframe in keyframes]).astype(
            np.float32
        )
        similarity = descriptors @ query.vlad_descriptor.astype(np.float32)
        best = np.argsort(-similarity, kind="stable")[:count]
        return [keyframes[n] for n in best]
