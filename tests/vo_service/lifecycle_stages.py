"""The stages of a service's life at which a signal may come: how each is reached."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import EndOfStream, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.playback.camera import RecordingCamera
from tests.forked_process import ForkedProcess
from tests.vo_service.service_process import START_TIMEOUT_S
from tests.vo_service.service_runner import CAMERA, ServiceRunner
from tests.waiting import wait_until

# From this frame on.
FAULT_CONFIG = '[[synthetic.faults]]\nkind = "{}"\nfirst = 5\ncount = {}\nseconds = {}\n'
MANY_FRAMES = 1_000_000


def check_nothing(stage: ServiceRunner) -> None:
    """There is nothing left to see."""


@dataclass(frozen=True)
class LifecycleStage:
    """A name, what the camera does, and how to get there once the service has been started.

    goes_on  whether statuses are received from then on
    check    what must hold once the service has ended
    popen    how the service is started
    """

    name: str
    config: str
    reach: Callable[[ServiceRunner], None]
    keeps_running: bool = True
    check: Callable[[ServiceRunner], None] = check_nothing
    popen: "type[subprocess.Popen[bytes]]" = ForkedProcess


def reach_starting(stage: ServiceRunner) -> None:
    """It heeds signals, but does not publish yet."""
    process = stage.service.process.pid
    wait_until(lambda: signal.SIGTERM in handled_signals(process), "the service to heed signals")
    assert not stage.service.received.statuses


def reach_waiting_for_camera(stage: ServiceRunner) -> None:
    """The camera was there and has gone."""
    stage.service.wait_for_reason("unplugged", 0.0, START_TIMEOUT_S)


def reach_streaming(stage: ServiceRunner) -> None:
    """Poses come."""
    stage.service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)


def reach_lost(stage: ServiceRunner) -> None:
    """Poses come, and say that they are worth nothing."""
    reach_streaming(stage)
    stage.service.wait_for_status(lambda status: status["state"] == "lost")


def reach_recording(stage: ServiceRunner) -> None:
    """Frames go to the disk."""
    reach_streaming(stage)
    wait_until(lambda: stage.is_accepted("start-recording", name="room"), "the recorder")
    folder = stage.state_folder / "recordings" / "room" / "rgb"
    wait_until(lambda: any(folder.glob("*")), "a recorded image")


def check_recording_complete(stage: ServiceRunner) -> None:
    """Every image of the list can be read again."""
    folder = stage.state_folder / "recordings" / "room"
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        seqs = [frame.seq for frame in read_frames(camera)]
    assert len(seqs) == len(list((folder / "rgb").glob("*"))) > 0
    assert camera.counters.skipped == 0


def read_frames(camera: RgbdCamera) -> Iterator[RgbdFrame]:
    """All of a recording."""
    with suppress(EndOfStream):
        while True:
            yield camera.read(1.0)


def reach_closing(stage: ServiceRunner) -> None:
    """It has been asked to end a moment ago."""
    reach_streaming(stage)
    stage.service.process.send_signal(signal.SIGTERM)


def handled_signals(process: int) -> set[int]:
    """Numbers of the signals that a process has a handler for."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "SigCgt":
            mask = int(value, 16)
            return {number for number in range(1, 65) if mask >> (number - 1) & 1}
    raise ValueError(f"process {process} tells of no signals")


STAGES = (
    LifecycleStage("start-up", CAMERA, reach_starting, keeps_running=False, popen=subprocess.Popen),
    LifecycleStage(
        "waiting for a camera",
        CAMERA + FAULT_CONFIG.format("unplugged", 1, 3600.0),
        reach_waiting_for_camera,
    ),
    LifecycleStage("streaming", CAMERA, reach_streaming),
    LifecycleStage("lost", CAMERA + FAULT_CONFIG.format("covered", MANY_FRAMES, 0.0), reach_lost),
    LifecycleStage("recording", CAMERA, reach_recording, check=check_recording_complete),
    LifecycleStage("closing", CAMERA, reach_closing, keeps_running=False),
)
