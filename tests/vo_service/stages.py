"""The stages of a service's life at which a signal may come: how each is reached."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import EndOfStream, Pace, RgbdCamera, RgbdFrame
from drivers.tum.camera import TumCamera
from tests.preloaded import Preloaded
from tests.vo_service.live_stage import CAMERA, LiveStage
from tests.vo_service.played_service import START_LIMIT_S
from tests.waiting import wait_until

# From this frame on.
FAULT = '[[synthetic.faults]]\nkind = "{}"\nfirst = 5\ncount = {}\nseconds = {}\n'
FOR_EVER = 1_000_000


def nothing_more(stage: LiveStage) -> None:
    """There is nothing left to see."""


@dataclass(frozen=True)
class Stage:
    """A name, what the camera does, and how to get there once the service has been started.

    goes_on  whether statuses are heard from then on
    check    what must hold once the service has ended
    popen    how the service is started
    """

    name: str
    config: str
    reach: Callable[[LiveStage], None]
    goes_on: bool = True
    check: Callable[[LiveStage], None] = nothing_more
    popen: "type[subprocess.Popen[bytes]]" = Preloaded


def starting(stage: LiveStage) -> None:
    """It heeds signals, but does not publish yet."""
    process = stage.service.process.pid
    wait_until(lambda: signal.SIGTERM in caught_by(process), "the service to heed signals")
    assert not stage.service.heard.statuses


def waiting(stage: LiveStage) -> None:
    """The camera was there and has gone."""
    stage.service.until_said("unplugged", 0.0, START_LIMIT_S)


def streaming(stage: LiveStage) -> None:
    """Poses come."""
    stage.service.until_streaming(time.monotonic(), START_LIMIT_S)


def lost(stage: LiveStage) -> None:
    """Poses come, and say that they are worth nothing."""
    streaming(stage)
    stage.service.until(lambda status: status["state"] == "lost")


def recording(stage: LiveStage) -> None:
    """Frames go to the disk."""
    streaming(stage)
    wait_until(lambda: stage.is_obeyed("start-recording", name="room"), "the recorder")
    folder = stage.state_folder / "recordings" / "room" / "rgb"
    wait_until(lambda: any(folder.glob("*")), "a recorded image")


def recording_is_whole(stage: LiveStage) -> None:
    """Every image of the list can be read again."""
    folder = stage.state_folder / "recordings" / "room"
    with TumCamera(folder, None, Pace.LOCKSTEP) as camera:
        seqs = [frame.seq for frame in frames_of(camera)]
    assert len(seqs) == len(list((folder / "rgb").glob("*"))) > 0
    assert camera.counters.skipped == 0


def frames_of(camera: RgbdCamera) -> Iterator[RgbdFrame]:
    """All of a recording."""
    with suppress(EndOfStream):
        while True:
            yield camera.read(1.0)


def closing(stage: LiveStage) -> None:
    """It has been asked to end a moment ago."""
    streaming(stage)
    stage.service.process.send_signal(signal.SIGTERM)


def caught_by(process: int) -> set[int]:
    """Numbers of the signals that a process has a handler for."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "SigCgt":
            mask = int(value, 16)
            return {number for number in range(1, 65) if mask >> (number - 1) & 1}
    raise ValueError(f"process {process} tells of no signals")


STAGES = (
    Stage("start-up", CAMERA, starting, goes_on=False, popen=subprocess.Popen),
    Stage("waiting for a camera", CAMERA + FAULT.format("unplugged", 1, 3600.0), waiting),
    Stage("streaming", CAMERA, streaming),
    Stage("lost", CAMERA + FAULT.format("covered", FOR_EVER, 0.0), lost),
    Stage("recording", CAMERA, recording, check=recording_is_whole),
    Stage("closing", CAMERA, closing, goes_on=False),
)
