"""The mapper process: it handles requests and the frames of the ring.

Each mesh is built in another process.
"""

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.core import InputError, UserFacingError
from drivers.core.files import MEGABYTE, check_writable
from drivers.core.geometry import Array
from drivers.core.memory import release_memory
from drivers.core.process.record_ring import RecordRingReader, RingRecord
from drivers.core.process.service_connection import ServiceConnection
from vo_service.config_tables import MapConfig
from vo_service.frame_record import decode_metadata
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.slam.mapper.keyframe_grid import KeyframeGrid
from vo_service.slam.mapper.map_store import MapStore
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
from vo_service.slam.pose_graph import AnchoredPose
from vo_service.types.occupancy_grid import NO_GRID
from vo_service.types.odometry_update import TrackingState

if TYPE_CHECKING:  # its libraries take a second and a hundred megabytes
    from vo_service.slam.map_cells import MapCells
    from vo_service.slam.map_file import MapContents
    from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker
    from vo_service.slam.pose_graph import NodeRemoval


STATUS_PERIOD_S = 1.0
POLL_PERIOD_S = 0.2


def run_mapper(service: ServiceConnection, fuse_keyframes: FuseKeyframes) -> None:
    """Run until the service asks the process to end; a running mesh job is cancelled."""
    os.umask(0o077)  # other users must not read images of the robot's surroundings
    worker = MapperWorker(service.config, service.send, service.close, fuse_keyframes)
    try:
        _serve(service, worker)
    except EOFError:
        pass  # the service ends
    finally:
        worker.cancel_jobs()


def _serve(service: ServiceConnection, worker: "MapperWorker") -> None:
    """Run until the end. Raises EOFError."""
    last_status_s = -math.inf
    while not service.stop.is_set():
        is_due = time.monotonic() - last_status_s >= STATUS_PERIOD_S
        if worker.process_frames() or is_due:
            last_status_s = time.monotonic()
            service.send(worker.status)
        request = service.receive(POLL_PERIOD_S, *worker.result_connections)
        if request is not None:
            worker.process_frames()  # frames before the request
            worker.handle(request)
        elif wait(worker.result_connections, 0.0):
            worker.send_job_results()


class MapperWorker:
    """Stores keyframes, and builds meshes of them, one at a time.

    Args:
        config: Of the mapper.
        send: Sends a message to the service.
        close_inherited: Called in each process that builds a mesh, to close inherited connections.
    """

    def __init__(
        self,
        config: MapperWorkerConfig,
        send: SendMapperMessage,
        close_inherited: Callable[[], None],
        fuse_keyframes: FuseKeyframes,
    ) -> None:
        self._settings, self._send, self._close_inherited = config.map_config, send, close_inherited
        self._ring, self._next_record = RecordRingReader(config.frame_ring), config.first_frame
        self._grid = KeyframeGrid(config, send)
        self._keyframes = MeshKeyframeStore(config.map_config.max_mb * MEGABYTE)
        self._store = MapStore(config.maps_folder)
        self._loop_closure = open_loop_closure_worker(config.map_config, send)
        GridMapper.warm_up()
        release_memory()  # all kernels are loaded
        self._fuse_keyframes = fuse_keyframes
        self._mesh_jobs: list[MeshJob] = []  # at most one
        with suppress(OSError):  # the status reports the error
            self._store.clean_up()
        if config.map_config.load is not None:
            self._load_map(config.map_config.load)

    @property
    def status(self) -> MapperStatus:
        """Status for the service."""
        names = loadable_names = frozenset[str]()
        with suppress(OSError):  # the status reports the error
            names, loadable_names = self._store.names, self._store.loadable_names
        return MapperStatus(
            len(self._keyframes), names, loadable_names, check_writable(self._store.folder)
        )

    @property
    def result_connections(self) -> "list[Connection[Any, Any]]":
        """Connections that are ready when a mesh job has finished."""
        return [job.result_connection for job in self._mesh_jobs]

    def process_frames(self) -> bool:
        """Process new frames and answer the pending query; return whether there were frames."""
        last = self._ring.record_count
        first, self._next_record = max(self._next_record, self._ring.oldest_number), last
        for number in range(first, last):
            record = self._ring.read_record(number)
            if record is not None:  # None if it is already overwritten
                self._process_record(record)
        self._loop_closure.answer_query()
        self._grid.send_if_due(self._keyframes, self._loop_closure)
        return first < last

    def handle(self, request: SaveMapRequest | LoadMapRequest | MapConfig) -> None:
        """Start the request; its result is sent to the service."""
        match request:
            case SaveMapRequest(name):
                self._save_map(name)
            case LoadMapRequest(name):
                self._load_map(name)
            case MapConfig():
                self._settings = request
                self._keyframes.set_max_bytes(request.max_mb * MEGABYTE)

    def send_job_results(self) -> None:
        """Send the result of the mesh job; waits for it.

        The names of the maps go first, so that a map that is reported as saved can be loaded.
        """
        while self._mesh_jobs:
            result = self._mesh_jobs.pop().wait_for_result()
            self._send(self.status)
            self._send(result)

    def cancel_jobs(self) -> None:
        """Kill the mesh job, and remove its partial files."""
        while self._mesh_jobs:
            self._mesh_jobs.pop().kill()
        with suppress(OSError):
            self._store.clean_up()

    def _process_record(self, record: RingRecord) -> None:
        self._grid.mark_stale()
        for removal in self._loop_closure.process_record(record):
            self._keyframes.re_anchor(removal)
            self._grid.re_anchor(removal)
        published = decode_metadata(record.metadata).published
        is_tracked = published.state is TrackingState.TRACKING  # else it is only a query
        if is_tracked and self._keyframes.accepts(published.epoch, published.T_world_camera):
            self._keyframes.add(
                MeshKeyframe.from_record(
                    record,
                    self._loop_closure.anchor_to_last_keyframe(published.T_world_camera),
                    self._grid.mapper,
                )
            )

    def _load_map(self, name: str) -> None:
        """Load a map. Earlier mesh keyframes belong to the old map and are dropped."""
        file = self._store.map_file(name)
        try:
            contents = self._loop_closure.load(file)
        except InputError as error:
            self._send(LoadMapResult(file, error=str(error)))
            return
        self._keyframes.clear()
        grid_fault = self._grid.load(contents.cells)
        self._send(LoadMapResult(file, len(contents.keyframes), grid_fault=grid_fault))

    def _save_map(self, name: str) -> None:
        """Write the map and its grid, and start the mesh job; nothing without a keyframe."""
        file = self._store.mesh_file(name)
        try:
            if len(self._keyframes) == 0:  # none since a map was loaded
                raise UserFacingError(f"{file}: there is no keyframe yet")
            max_total_bytes = self._settings.total_mb * MEGABYTE
            cells = self._grid.contents(self._keyframes, self._loop_closure)
            self._loop_closure.save(self._store, name, max_total_bytes, cells)
            grid = self._grid.render(self._keyframes, self._loop_closure)
            if grid is not NO_GRID:
                self._store.write_grid(name, grid, max_total_bytes)
            self._start_mesh_job(file, name)
        except UserFacingError as error:
            self._send(SaveMapResult(file, error=str(error)))

    def _start_mesh_job(self, file: Path, name: str) -> None:
        """Start the process that makes the mesh. Raises UserFacingError if that fails."""
        keyframes = [
            replace(each, T_odom_camera=self._loop_closure.T_map_camera(each.anchored_pose))
            for each in self._keyframes
        ]
        build = partial(
            build_mesh, self._store, name, keyframes, self._settings, self._fuse_keyframes
        )
        try:
            self._mesh_jobs.append(MeshJob(file, build, self._close_inherited))
        except OSError as error:
            text = f"{file}: the mesh process cannot be started: {error.strerror}"
            raise UserFacingError(text) from error


class NullLoopClosureWorker:
    """Loop closure worker that does nothing."""

    is_localized = True

    def process_record(self, record: RingRecord) -> "Sequence[NodeRemoval]":
        """Do nothing; no node is removed."""
        return ()

    def answer_query(self) -> None:
        """Do nothing."""

    def save(self, store: MapStore, name: str, max_total_bytes: int, cells: "MapCells") -> None:
        """Do nothing."""

    def load(self, file: Path) -> "MapContents":
        """Raise InputError, as loop closure is disabled."""
        raise InputError(f"{file}: loop closure is disabled (map.loop_closure)")

    def anchor_to_last_keyframe(self, T_odom_camera: Array) -> AnchoredPose:
        """Return the pose relative to the map, which is `odom`."""
        return AnchoredPose(None, T_odom_camera)

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """4x4 pose in the map."""
        return pose.T_keyframe_camera


def open_loop_closure_worker(
    settings: MapConfig, send: SendMapperMessage
) -> "LoopClosureWorker | NullLoopClosureWorker":
    """Open the loop closure worker of the settings."""
    if not settings.loop_closure:
        return NullLoopClosureWorker()
    from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker

    return LoopClosureWorker(settings, send)
