"""An incident replays as it was: the same poses, bit for bit, from the service's own loop."""

import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Clock, Pace, RgbdFrame
from drivers.isolation.camera import IsolatedCamera
from tests.drivers.isolation.trial_cameras import Puppet, is_whole
from tests.drivers.tum.replaying import replayed
from tests.vo_service.commands.command_line import call
from tests.vo_service.fakes import Collector, ScriptedCamera
from tests.vo_service.recorder.moments import feed, incident, recorder, update
from tests.waiting import wait_until
from vo_service.app import run_loop
from vo_service.config import Config
from vo_service.feed import PlainFeed
from vo_service.interrupts import Stop
from vo_service.recorder.recorder import FlightRecorder
from vo_service.settings import RecorderSettings
from vo_service.types import PoseUpdate

pytestmark = pytest.mark.subprocess


def blinded(frame: RgbdFrame) -> RgbdFrame:
    """The same, but black, and with no depth."""
    colour_bgr, depth_raw = np.zeros_like(frame.colour_bgr), np.zeros_like(frame.depth_raw)
    return replace(frame, colour_bgr=colour_bgr, depth_raw=depth_raw)


class OneByOne(Collector):
    """An output that holds the loop up until the recorder has taken each frame."""

    def __init__(self, recorder: FlightRecorder) -> None:
        super().__init__()
        self._recorder = recorder

    def pose(self, update: PoseUpdate) -> None:
        """Wait for it."""
        super().pose(update)
        wait_until(lambda: self._recorder.remembered == len(self.poses))


def test_a_loss_of_tracking_replays_to_the_poses_that_the_service_gave(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    frames = replayed(recording)
    camera = ScriptedCamera([*frames[:7], blinded(frames[7]), *frames[8:]])
    with recorder(tmp_path, RecorderSettings(max_mb=20)) as opened, camera:
        run_loop(Config(), camera, PlainFeed(camera), [opened, OneByOne(opened)], Stop())
    folder = incident(tmp_path, "lost")
    again = tmp_path / "again.txt"
    outcome = call(capfd, "replay", folder, "--trajectory", again, "--no-publish")
    assert outcome.code == 0, outcome.err
    told = (folder / "trajectory.txt").read_text().splitlines()
    assert again.read_text().splitlines() == told[1:]
    assert len(told[1:]) == len(frames) - 1


def test_frames_from_before_a_crash_of_the_driver_are_still_there(tmp_path: Path) -> None:
    (tmp_path / "script").touch()  # no words: the puppet works
    make = partial(Puppet, tmp_path / "script")
    driver = IsolatedCamera("puppet", Clock.MONOTONIC, make, Pace.REALTIME)
    with recorder(tmp_path, RecorderSettings(max_mb=20)) as opened, driver as camera:
        frames = [camera.read(30.0) for _ in range(5)]
        feed(opened, *(replace(update(0), frame=frame) for frame in frames))
        os.kill(frames[-1].lost_packets, signal.SIGKILL)
        feed(opened, replace(update(0), frame=camera.read(30.0)))
        opened.save("command")
        found = replayed(incident(tmp_path, "command"))
    assert [is_whole(frame) for frame in found] == [True] * 6
