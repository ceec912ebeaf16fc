"""One table: a worker process may do anything; it is reported, replaced and never left behind."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

from drivers.camera import Clock, PlaybackMode
from drivers.core import UserFacingError
from drivers.core.process import worker_spec
from drivers.subprocess_camera import camera as camera_client
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.forked_process import forked_workers
from tests.resource_leaks import child_pids, is_alive, resources_in_use
from tests.waiting import wait_until
from vo_service.config_tables import MapConfig, RecorderConfig
from vo_service.outputs.recorder import client as recorder
from vo_service.outputs.rerun import output as viewer_client
from vo_service.outputs.rerun.sinks import RrdFileSink
from vo_service.slam.mapper import client as mapper

pytestmark = pytest.mark.subprocess

FAULTS = ("crash_at_start", "crash_later", "hang", "flood", "refuse_to_end", "work")
FUNCTIONS = {f"tests.vo_service.faulty_workers:{fault}" for fault in FAULTS}


@dataclass(frozen=True)
class OpenWorker:
    """A client with its worker: its report of faults ("" for none), and how to close it."""

    report: Callable[[], str]
    close: Callable[[], object]


def open_camera(folder: Path) -> OpenWorker:
    camera = SubprocessCamera(
        "faulty", Clock.MONOTONIC, partial(str), PlaybackMode.REALTIME,  # type: ignore[arg-type]
        Timeouts(launching_s=5.0, closing_s=0.5, orphan_s=1.0),
    )  # fmt: skip
    camera.open()
    return OpenWorker(lambda: camera.status.reason, camera.close)


def open_viewer(folder: Path) -> OpenWorker:
    output = viewer_client.RerunOutput(RrdFileSink(folder / "out.rrd"))
    return OpenWorker(lambda: output.warning, partial(_close_incomplete, output))


def _close_incomplete(output: viewer_client.RerunOutput) -> None:
    with suppress(UserFacingError):  # the recording is incomplete
        output.close()


def open_recorder(folder: Path) -> OpenWorker:
    output = recorder.FlightRecorder(RecorderConfig(max_mb=1), folder, {})
    return OpenWorker(lambda: output.warning, output.close)


def open_mapper(folder: Path) -> OpenWorker:
    output = mapper.LiveMapper(MapConfig(loop_closure=False), folder)
    return OpenWorker(lambda: output.warning, output.close)


# How each worker is opened, and the module with its `WorkerSpec`.
WORKERS: dict[str, tuple[Callable[[Path], OpenWorker], ModuleType, str]] = {
    "camera": (open_camera, camera_client, "CAMERA_WORKER"),
    "viewer": (open_viewer, viewer_client, "RERUN_WORKER"),
    "recorder": (open_recorder, recorder, "WORKER_SPEC"),
    "mapper": (open_mapper, mapper, "WORKER_SPEC"),
}
MakeFaulty = Callable[[str], OpenWorker]


@pytest.fixture(params=WORKERS)
def make_faulty(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[MakeFaulty]:
    """Opens a worker whose process has a fault; at the end nothing of it is left."""
    open_worker, module, name = WORKERS[request.param]
    before, opened = resources_in_use(), []

    def make(fault: str) -> OpenWorker:
        spec = replace(
            getattr(module, name),
            function=f"tests.vo_service.faulty_workers:{fault}",
            start_timeout_s=5.0,
            heartbeat_timeout_s=1.0,
            exit_timeout_s=0.5,
            orphan_timeout_s=1.0,
        )
        monkeypatch.setattr(module, name, spec)
        opened.append(open_worker(tmp_path))
        return opened[0]

    monkeypatch.setattr(worker_spec, "FINISHING_TIMEOUT_S", 0.5)
    # The viewer's process does not draw, so nobody waits for it.
    monkeypatch.setattr(viewer_client, "START_TIMEOUT_S", 0.0)
    monkeypatch.setattr(viewer_client, "CLOSE_TIMEOUT_S", 0.5)
    with forked_workers(FUNCTIONS):
        yield make
        opened[0].close()
    wait_until(lambda: resources_in_use() <= before, "nothing to be left")


@pytest.mark.parametrize("fault", ["crash_at_start", "crash_later", "hang"])
def test_a_fault_is_reported_and_the_process_started_again(
    make_faulty: MakeFaulty, fault: str
) -> None:
    worker = make_faulty(fault)
    wait_until(lambda: worker.report() != "")
    (first,) = child_pids() or [0]
    wait_until(lambda: set(child_pids()) - {first}, "another process")


def test_a_stopped_process_is_replaced(make_faulty: MakeFaulty) -> None:
    worker = make_faulty("work")
    wait_until(lambda: len(child_pids()) == 1)
    (process,) = child_pids()
    os.kill(process, signal.SIGSTOP)
    wait_until(lambda: worker.report() != "" and not is_alive(process))


@pytest.mark.parametrize("fault", ["flood", "refuse_to_end"])
def test_a_process_that_does_not_listen_is_no_fault_and_is_not_left_behind(
    make_faulty: MakeFaulty, fault: str
) -> None:
    worker = make_faulty(fault)
    wait_until(lambda: len(child_pids()) == 1)
    assert worker.report() == ""
