"""The map as the service sees it: an output that passes keyframes on."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.geometry import Array
from vo_service.mapping.live.clerk import MapClerk
from vo_service.mapping.live.contract import MapState
from vo_service.mapping.live.messages import Job
from vo_service.mapping.live.spacing import Gate
from vo_service.outputs.output import PoseUpdate, Status
from vo_service.outputs.worker import DropOldest, Worker
from vo_service.recorder.depth_packing import compile_packing, pack_depth
from vo_service.recorder.frame_record import put_frame
from vo_service.recorder.shared_ring import RingWriter
from vo_service.settings import MapSettings

logger = logging.getLogger(__name__)

# The process takes keyframes out several times a second: so much is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_WORKER_S = 1.0


class LiveMapper:
    """Keyframes go through shared memory to a process that keeps them, and makes the maps.

    The loop only compares two poses; a thread copies the images of a keyframe.
    """

    def __init__(self, settings: MapSettings, maps: Path, T_base_camera: Array) -> None:
        """Start. `maps` is the folder of the maps. Raises OSError if the memory cannot be had."""
        self._T_base_camera = T_base_camera
        self._gate = Gate()
        self._no_memory = ""
        self._is_closed = False
        compile_packing()
        self._ring = RingWriter("map-keyframes", _RING_S, _RING_BYTES)
        level = logging.getLogger().getEffectiveLevel()
        self._clerk = MapClerk(Job(self._ring.memory, 0, maps, settings, level), self._begin_anew)
        self._worker: Worker[PoseUpdate] = Worker("map", DropOldest(1), self._put, lambda: None)

    @property
    def warning(self) -> str:
        """What is wrong with it, in one clause."""
        return self._no_memory or self._clerk.warning

    @property
    def state(self) -> MapState:
        """As `Mapper`."""
        return self._clerk.state

    @property
    def is_up(self) -> bool:
        """Whether its process takes orders."""
        return self._clerk.is_up

    def pose(self, update: PoseUpdate) -> None:
        """Pass a frame on (soon) if it is to be a keyframe."""
        if self._gate.lets_through(update):
            self._worker.put(update)

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, name: str) -> MapState:
        """As `Mapper`."""
        return self._clerk.save(name)

    def configure(self, settings: MapSettings) -> None:
        """As `Mapper`."""
        self._clerk.configure(settings)

    def close(self) -> None:
        """Forget everything; a map that is being made is given up."""
        if self._is_closed:
            return
        self._is_closed = True
        has_finished = self._worker.close(_WORKER_S)
        self._clerk.close()
        if has_finished:
            self._ring.close()

    def _put(self, update: PoseUpdate) -> None:
        """Body of the worker's thread. The map's world is `odom`, as the poses that go out."""
        T_odom_camera = np.asarray(update.T_odom_base @ self._T_base_camera)
        try:
            put_frame(self._ring, replace(update, T_world_camera=T_odom_camera), pack_depth)
            self._no_memory = ""
        except OSError as error:
            self._no_memory = f"map: no memory for a keyframe: {error.strerror}"

    def _begin_anew(self) -> int:
        """The keyframes are lost: the next good frame is one, wherever it is."""
        first = self._ring.count
        self._gate.forget()
        return first
