"""Commands take effect between two frames, and are told of."""

import threading
from collections.abc import Mapping

import pytest

from tests.vo_service.fakes import (
    CollectingOutput,
    Delay,
    FakeClock,
    ScriptedCamera,
    make_frame,
)
from tests.vo_service.service_loop import make_service
from vo_service import service as service_module
from vo_service.control import CommandQueue
from vo_service.frame_source import FrameSource
from vo_service.types.commands import Command, PauseCommand, ResetCommand, ResumeCommand
from vo_service.types.odometry_update import OdometryUpdate


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """The loop's own clock."""
    clock = FakeClock()
    monkeypatch.setattr(service_module, "time", clock)
    return clock


class Commander(CollectingOutput):
    """Sends a command after each pose of a script."""

    def __init__(self, inbox: CommandQueue, script: Mapping[int, Command]) -> None:
        super().__init__()
        self._inbox, self._script = inbox, script

    def on_update(self, update: OdometryUpdate) -> None:
        """Keep it, then say what is due."""
        super().on_update(update)
        if update.frame.seq in self._script:
            self._inbox.submit(self._script[update.frame.seq])


def test_a_reset_applies_to_the_next_frame() -> None:
    inbox = CommandQueue()
    collector = Commander(inbox, {1: ResetCommand()})
    camera = ScriptedCamera([make_frame(k) for k in range(4)])
    with camera:
        make_service(FrameSource(camera), [collector], inbox=inbox).run(threading.Event())
    assert [pose.epoch for pose in collector.poses] == [0, 0, 1, 1]
    assert [pose.reason for pose in collector.poses] == ["", "", "reset", ""]


def test_a_pause_is_a_reason_for_missing_poses(clock: FakeClock) -> None:
    inbox = CommandQueue()
    collector = Commander(inbox, {1: PauseCommand()})
    camera = ScriptedCamera([Delay(0.2, make_frame(k)) for k in range(20)], clock=clock)
    with camera:
        make_service(FrameSource(camera), [collector], inbox=inbox).run(threading.Event())
    assert [pose.frame.seq for pose in collector.poses] == [0, 1]
    paused = [status for status in collector.statuses if status.paused]
    assert {(status.state.value, status.reason) for status in paused} == {("lost", "paused")}
    assert len(paused) > 5


def test_after_a_pause_poses_continue() -> None:
    inbox = CommandQueue()
    inbox.submit(PauseCommand())
    inbox.submit(ResumeCommand())
    camera, collector = ScriptedCamera([make_frame(k) for k in range(3)]), CollectingOutput()
    with camera:
        make_service(FrameSource(camera), [collector], inbox=inbox).run(threading.Event())
    assert len(collector.poses) == 3
    assert not collector.statuses[-1].paused
