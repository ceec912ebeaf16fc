"""The keyframes of a map, in memory: packed, and thinned out evenly where there are too many."""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.geometry import Array
from vo_service.mapping.loops.from_place import FromPlace
from vo_service.mapping.spacing import steps_between
from vo_service.recorder.depth_unpacking import unpack_depth
from vo_service.recorder.frame_record import frame_of, note_of
from vo_service.recorder.shared_ring import Record

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.mapping.graph.pose_graph import Removal

JPEG_QUALITY = 90
# How much further apart keyframes are after each thinning.
_WIDER = math.sqrt(2.0)


@dataclass(frozen=True)
class Keyframe:
    """One view: colour as JPEG, depth without loss, and where the camera was.

    from_place  the same pose, for when the map is corrected
    """

    epoch: int
    T_odom_camera: Array
    camera: PinholeCamera
    depth_factor: float
    jpeg: bytes
    packed_depth: bytes
    from_place: FromPlace

    @classmethod
    def of(cls, record: Record, from_place: FromPlace) -> Self:
        """From a frame in the ring, whose `T_world_camera` leads to `odom`."""
        note = note_of(record.note)
        colour_bgr = frame_of(record, 0.0).colour_bgr
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        return cls(
            epoch=note.said.epoch,
            T_odom_camera=note.said.T_world_camera,
            camera=note.camera,
            depth_factor=note.depth_factor,
            jpeg=cv2.imencode(".jpg", colour_bgr, options)[1].tobytes(),
            packed_depth=zlib.compress(record.payload[: note.depth_bytes], level=1),
            from_place=from_place,
        )

    @property
    def size(self) -> int:
        """Bytes of both images."""
        return len(self.jpeg) + len(self.packed_depth)

    @property
    def colour_bgr(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8, nearly as it was."""
        data = np.frombuffer(self.jpeg, np.uint8)
        colour: NDArray[np.uint8] = cv2.imdecode(data, cv2.IMREAD_COLOR)  # type: ignore[assignment]
        return colour

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 metres, 0 = no reading: every bit as it was."""
        packed = zlib.decompress(self.packed_depth)
        depth_raw = unpack_depth(packed, self.camera.height, self.camera.width)
        return depth_raw * np.float32(1.0 / self.depth_factor)


class Keyframes:
    """Those of one epoch, no two closer than `spacing` steps, in the order they were taken."""

    def __init__(self, most_bytes: int) -> None:
        self.spacing = 1.0
        self.bytes = 0
        self._most_bytes = most_bytes
        self._kept: list[Keyframe] = []

    def __len__(self) -> int:
        return len(self._kept)

    def __iter__(self) -> Iterator[Keyframe]:
        return iter(self._kept)

    @property
    def epoch(self) -> int | None:
        """The epoch they are of; None while there are none."""
        return self._kept[-1].epoch if self._kept else None

    def wants(self, epoch: int, T_odom_camera: Array) -> bool:
        """Whether a view from there would be kept: to be asked before it is packed."""
        return epoch != self.epoch or self._is_apart(T_odom_camera)

    def add(self, keyframe: Keyframe) -> None:
        """Take a keyframe, unless there is one from nearly there; the first of an epoch empties."""
        if keyframe.epoch != self.epoch:
            self.forget()
        if self._is_apart(keyframe.T_odom_camera):
            self._keep(keyframe)
            self.hold_at_most(self._most_bytes)

    def carry_over(self, removal: "Removal") -> None:
        """The same, when a place is no more."""
        self._kept = [
            replace(each, from_place=each.from_place.carried_over(removal)) for each in self._kept
        ]

    def forget(self) -> None:
        """All of them."""
        self._kept, self.bytes, self.spacing = [], 0, 1.0

    def hold_at_most(self, most_bytes: int) -> None:
        """From now on; wider apart if they are too many. The first of all stays."""
        self._most_bytes = most_bytes
        while self.bytes > most_bytes and len(self._kept) > 1:
            self.spacing *= _WIDER
            before, self._kept, self.bytes = self._kept, [], 0
            for keyframe in before:
                if self._is_apart(keyframe.T_odom_camera):
                    self._keep(keyframe)

    def _keep(self, keyframe: Keyframe) -> None:
        self._kept.append(keyframe)
        self.bytes += keyframe.size

    def _is_apart(self, T_odom_camera: Array) -> bool:
        """Whether no keyframe is from nearly there."""
        if not self._kept:
            return True
        others = np.array([kept.T_odom_camera for kept in self._kept])
        return bool(steps_between(T_odom_camera, others).min() >= self.spacing)
