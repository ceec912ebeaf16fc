"""What the mapper's process does when it is told to, and with what comes through the ring."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import check_writable
from drivers.core.shared_frames.record_ring import RecordRingReader, RingRecord
from vo_service.config_tables import MEGABYTE, MapConfig
from vo_service.frame_record import decode_metadata
from vo_service.slam.mapper.mesh_job import FuseKeyframes, MeshJob, build_mesh
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe, MeshKeyframeStore
from vo_service.slam.mapper.messages import (
    LoadMapRequest,
    LoadMapResult,
    MapperStatus,
    MapperWorkerConfig,
    SaveMapRequest,
    SaveMapResult,
    SendMapperMessage,
)
from vo_service.slam.mapper.null_loop_closure_worker import open_loop_closure_worker
from vo_service.slam.saved_maps.map_store import MapStore
from vo_service.types import TrackingState


class MapperWorker:
    """Keeps the keyframes, and has a map made of them, one at a time."""

    def __init__(
        self,
        config: MapperWorkerConfig,
        send: SendMapperMessage,
        close_inherited: Callable[[], None],
        fuse_keyframes: FuseKeyframes,
    ) -> None:
        """`close_inherited` is called in each process that makes a map, to let go of what is ours."""
        self._settings, self._send, self._close_inherited = config.map_config, send, close_inherited
        self._ring, self._next_record = RecordRingReader(config.frame_ring), config.first_frame
        self._keyframes = MeshKeyframeStore(config.map_config.max_mb * MEGABYTE)
        self._store = MapStore(config.maps_folder)
        self._loop_closure = open_loop_closure_worker(config.map_config, send)
        self._fuse_keyframes = fuse_keyframes
        self._mesh_jobs: list[MeshJob] = []  # one at most
        with suppress(OSError):  # the facts tell what is wrong with the folder
            self._store.clean_up()
        if config.map_config.load is not None:
            self._load_map(config.map_config.load)

    @property
    def status(self) -> MapperStatus:
        """What is told every second."""
        names = with_places = frozenset[str]()
        with suppress(OSError):  # it is the trouble
            names, with_places = self._store.names, self._store.loadable_names
        return MapperStatus(
            len(self._keyframes), names, with_places, check_writable(self._store.folder)
        )

    @property
    def result_connections(self) -> "list[Connection[Any, Any]]":
        """Of which one is ready when a map has ended."""
        return [making.result_connection for making in self._mesh_jobs]

    def process_frames(self) -> bool:
        """Take the frames that have come, and answer what was asked; whether there were any."""
        end = self._ring.record_count
        begin, self._next_record = max(self._next_record, self._ring.oldest_number), end
        for number in range(begin, end):
            record = self._ring.read_record(number)
            if record is not None:  # else they came too fast: the next is not far
                self._process_record(record)
        self._loop_closure.answer_query()
        return begin < end

    def handle(self, request: SaveMapRequest | LoadMapRequest | MapConfig) -> None:
        """Begin what is ordered; how it ends is told."""
        match request:
            case SaveMapRequest(name):
                self._save_map(name)
            case LoadMapRequest(name):
                self._load_map(name)
            case MapConfig():
                self._settings = request
                self._keyframes.set_max_bytes(request.max_mb * MEGABYTE)

    def send_job_results(self) -> None:
        """Tell of a map that has ended; waits for it."""
        while self._mesh_jobs:
            self._send(self._mesh_jobs.pop().wait_for_result())

    def cancel_jobs(self) -> None:
        """End what is being made, and leave nothing of it."""
        while self._mesh_jobs:
            self._mesh_jobs.pop().kill()
        with suppress(OSError):
            self._store.clean_up()

    def _process_record(self, record: RingRecord) -> None:
        for removal in self._loop_closure.process_record(record):
            self._keyframes.re_anchor(removal)
        said = decode_metadata(record.metadata).published
        is_sure = said.state is TrackingState.TRACKING  # else it was only asked about
        if is_sure and self._keyframes.accepts(said.epoch, said.T_world_camera):
            self._keyframes.add(
                MeshKeyframe.from_record(
                    record, self._loop_closure.anchor_to_last_keyframe(said.T_world_camera)
                )
            )

    def _load_map(self, name: str) -> None:
        """Know the places of a map. Keyframes of before lie in a map that is no more."""
        file = self._store.map_file(name)
        try:
            places = self._loop_closure.load(file)
        except InputError as error:
            self._send(LoadMapResult(file, error=str(error)))
            return
        self._keyframes.clear()
        self._send(LoadMapResult(file, places))

    def _save_map(self, name: str) -> None:
        """Write the places, and begin to make the surface."""
        file = self._store.mesh_file(name)
        try:
            self._loop_closure.save(self._store, name, self._settings.total_mb * MEGABYTE)
        except UserFacingError as error:
            self._send(SaveMapResult(file, error=str(error)))
            return
        self._start_mesh_job(name)

    def _start_mesh_job(self, name: str) -> None:
        file = self._store.mesh_file(name)
        keyframes = [
            replace(each, T_odom_camera=self._loop_closure.T_map_camera(each.anchored_pose))
            for each in self._keyframes
        ]
        if not keyframes:
            self._send(SaveMapResult(file, error=f"{file}: there is no keyframe yet"))
            return
        make = partial(
            build_mesh, self._store, name, keyframes, self._settings, self._fuse_keyframes
        )
        try:
            self._mesh_jobs.append(MeshJob(file, make, self._close_inherited))
        except OSError as error:
            self._send(SaveMapResult(file, error=f"{file}: cannot be begun: {error.strerror}"))
