"""Keyframes of the mesh: color as JPEG and lossless depth, with a minimum spacing."""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from drivers.core.process.record_ring import RingRecord
from drivers.recording.image_encoding import encode_jpeg
from vo_service.frame_record import decode_frame, decode_metadata, unpack_depth
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.navigation.local_grid import NO_CELLS, LocalCells
from vo_service.slam.keyframe_selection import pose_distance_steps
from vo_service.slam.pose_graph import AnchoredPose

if TYPE_CHECKING:
    from vo_service.slam.pose_graph import NodeRemoval

JPEG_QUALITY = 90
# Factor of the spacing after each thinning.
_SPACING_GROWTH = math.sqrt(2.0)


@dataclass(frozen=True)
class MeshKeyframe:
    """A view with color as JPEG, lossless depth and its pose.

    Attributes:
        epoch: Of the pose.
        T_odom_camera: 4x4.
        camera: Intrinsics.
        depth_factor: Depth value per meter.
        jpeg: Color image.
        packed_depth: Depth image.
        anchored_pose: The pose relative to a keyframe of the map, which moves with the map.
        cells: What it tells of the occupancy grid, in its level frame.
    """

    epoch: int
    T_odom_camera: Array
    camera: PinholeCamera
    depth_factor: float
    jpeg: bytes
    packed_depth: bytes
    anchored_pose: AnchoredPose
    cells: LocalCells = field(default_factory=lambda: NO_CELLS)

    @classmethod
    def from_record(
        cls, record: RingRecord, anchored_pose: AnchoredPose, grid_mapper: GridMapper
    ) -> Self:
        """Make a keyframe of a frame in the ring, whose world frame is `odom`."""
        metadata = decode_metadata(record.metadata)
        frame = decode_frame(record, 0.0)
        return cls(
            epoch=metadata.published.epoch,
            T_odom_camera=metadata.published.T_world_camera,
            camera=metadata.camera,
            depth_factor=metadata.depth_factor,
            jpeg=encode_jpeg(frame.color_bgr, JPEG_QUALITY),
            packed_depth=zlib.compress(record.payload[: metadata.depth_bytes], level=1),
            anchored_pose=anchored_pose,
            cells=grid_mapper.cells(frame, metadata.published.T_world_camera),
        )

    @property
    def size_bytes(self) -> int:
        """Bytes of both images and the cells."""
        return len(self.jpeg) + len(self.packed_depth) + self.cells.nbytes

    @property
    def color_bgr(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8, with the loss of JPEG."""
        data = np.frombuffer(self.jpeg, np.uint8)
        color: NDArray[np.uint8] = cv2.imdecode(data, cv2.IMREAD_COLOR)  # type: ignore[assignment]
        return color

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 meters, 0 = no reading; lossless."""
        packed = zlib.decompress(self.packed_depth)
        depth_raw = unpack_depth(packed, self.camera.height, self.camera.width)
        return depth_raw * np.float32(1.0 / self.depth_factor)


class MeshKeyframeStore:
    """Mesh keyframes of one epoch in chronological order, with a minimum spacing.

    Args:
        max_bytes: Largest size.
    """

    def __init__(self, max_bytes: int) -> None:
        self.spacing_steps = 1.0
        self.size_bytes = 0
        self._max_bytes = max_bytes
        self._keyframes: list[MeshKeyframe] = []

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[MeshKeyframe]:
        return iter(self._keyframes)

    @property
    def epoch(self) -> int | None:
        """Epoch of the keyframes; None if there are none."""
        return self._keyframes[-1].epoch if self._keyframes else None

    def accepts(self, epoch: int, T_odom_camera: Array) -> bool:
        """Whether a view at a pose would be stored; to be called before it is compressed."""
        return epoch != self.epoch or self._is_far_from_all(T_odom_camera)

    def add(self, keyframe: MeshKeyframe) -> None:
        """Add a keyframe unless one is near; the first one of an epoch removes all others."""
        if keyframe.epoch != self.epoch:
            self.clear()
        if self._is_far_from_all(keyframe.T_odom_camera):
            self._append(keyframe)
            self.set_max_bytes(self._max_bytes)

    def re_anchor(self, removal: "NodeRemoval") -> None:
        """Re-anchor the poses after the removal of a map keyframe."""
        self._keyframes = [
            replace(each, anchored_pose=each.anchored_pose.re_anchor(removal))
            for each in self._keyframes
        ]

    def clear(self) -> None:
        """Remove all keyframes."""
        self._keyframes, self.size_bytes, self.spacing_steps = [], 0, 1.0

    def set_max_bytes(self, max_bytes: int) -> None:
        """Set the largest size; the spacing grows if it is exceeded. The first keyframe stays."""
        self._max_bytes = max_bytes
        while self.size_bytes > max_bytes and len(self._keyframes) > 1:
            self.spacing_steps *= _SPACING_GROWTH
            before, self._keyframes, self.size_bytes = self._keyframes, [], 0
            for keyframe in before:
                if self._is_far_from_all(keyframe.T_odom_camera):
                    self._append(keyframe)

    def _append(self, keyframe: MeshKeyframe) -> None:
        self._keyframes.append(keyframe)
        self.size_bytes += keyframe.size_bytes

    def _is_far_from_all(self, T_odom_camera: Array) -> bool:
        """Whether no keyframe is near a pose."""
        if not self._keyframes:
            return True
        others = np.array([each.T_odom_camera for each in self._keyframes])
        return bool(pose_distance_steps(T_odom_camera, others).min() >= self.spacing_steps)
