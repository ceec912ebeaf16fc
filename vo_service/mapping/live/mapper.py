"""The map as the service sees it: an output that passes keyframes and places on."""

import logging
from dataclasses import replace
from pathlib import Path

from vo_service.mapping.live.clerk import MapClerk
from vo_service.mapping.live.live_loops import LiveLoops
from vo_service.mapping.live.messages import Asked, Job
from vo_service.mapping.loops.hop import Hop, Hops, NoHops
from vo_service.mapping.spacing import Gate
from vo_service.outputs.worker import DropOldest, Worker
from vo_service.recorder.depth_packing import compile_packing, pack_depth
from vo_service.recorder.frame_record import put_frame
from vo_service.recorder.shared_ring import RingWriter
from vo_service.settings import MapSettings
from vo_service.types import Loops, MapState, NoLoops, PoseUpdate, Status

logger = logging.getLogger(__name__)

# The process takes keyframes out several times a second: so much is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_WORKER_S = 1.0


# A frame on its way to the process, and what goes with it into its note.
_Item = tuple[PoseUpdate, Hop | Asked | None]


class LiveMapper:
    """Frames go through shared memory to a process that keeps them, knows them again, makes maps.

    The loop only compares two poses; a thread copies the images of a frame.
    """

    def __init__(self, settings: MapSettings, maps: Path) -> None:
        """Start. `maps` is the folder of the maps. Raises OSError if the memory cannot be had."""
        self._gate = Gate()
        self._hops = Hops() if settings.loops else NoHops()
        self._no_memory = ""
        self._is_closed = False
        compile_packing()
        self._ring = RingWriter("map-keyframes", _RING_S, _RING_BYTES)
        level = logging.getLogger().getEffectiveLevel()
        places = LiveLoops(self._pass_on)
        self.loops: Loops = places if settings.loops else NoLoops()
        self._places = places
        job = Job(self._ring.memory, 0, maps, settings, level)
        self._clerk = MapClerk(job, places.hear, self._look_anew, self._begin_anew)
        self._worker: Worker[_Item] = Worker("map", DropOldest(2), self._put, lambda: None)

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
        """Pass a frame on (soon) if it is to be a keyframe or a place."""
        self._places.pose(update)
        hop = self._hops.next(update)
        if self._gate.lets_through(update) or hop is not None:
            self._pass_on(update, hop)

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, name: str) -> MapState:
        """As `Mapper`."""
        return self._clerk.save(name)

    def load(self, name: str) -> MapState:
        """As `Mapper`."""
        return self._clerk.load(name)

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

    def _pass_on(self, update: PoseUpdate, more: Hop | Asked | None) -> None:
        self._worker.put((update, more))

    def _put(self, item: _Item) -> None:
        """Body of the worker's thread. The map's world is `odom`, as the poses that go out."""
        update, more = item
        in_odom = replace(update, T_world_camera=update.T_odom_camera)
        try:
            put_frame(self._ring, in_odom, pack_depth, more)
            self._no_memory = ""
        except OSError as error:
            self._no_memory = f"map: no memory for a keyframe: {error.strerror}"

    def _look_anew(self) -> None:
        """The next good frame is a keyframe and a place, wherever it is."""
        self._gate.forget()
        self._hops.forget()

    def _begin_anew(self) -> int:
        """Keyframes and places are lost."""
        first = self._ring.count
        self._look_anew()
        self._places.begin_anew()
        return first
