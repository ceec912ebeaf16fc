"""An incident replays to the same poses, bit for bit."""

import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Clock, PlaybackMode, RgbdFrame
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.drivers.subprocess_camera.scripted_cameras import FileScriptedCamera, is_intact
from tests.drivers.tum.read_recording import read_recording
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.fakes import CollectingOutput, ScriptedCamera
from tests.vo_service.outputs.recorder.recorder_inputs import (
    make_update,
    running_recorder,
    save_incident,
    send_updates,
    wait_for_incident,
)
from tests.waiting import wait_until
from vo_service.app import run_replay
from vo_service.config import Config
from vo_service.frame_source import FrameSource
from vo_service.outputs.recorder.client import FlightRecorder
from vo_service.signals import StopSignal
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.subprocess


def blinded(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame in black and without depth."""
    color_bgr, depth_raw = np.zeros_like(frame.color_bgr), np.zeros_like(frame.depth_raw)
    return replace(frame, color_bgr=color_bgr, depth_raw=depth_raw)


class LockstepOutput(CollectingOutput):
    """Output that blocks the loop until the recorder has stored each frame."""

    def __init__(self, recorder: FlightRecorder) -> None:
        super().__init__()
        self._recorder = recorder

    def on_update(self, update: OdometryUpdate) -> None:
        """Wait for the recorder."""
        super().on_update(update)
        wait_until(lambda: self._recorder.frame_count == len(self.poses))


def test_a_tracking_loss_replays_to_the_published_poses(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    frames = read_recording(recording)
    camera = ScriptedCamera([*frames[:7], blinded(frames[7]), *frames[8:]])
    with running_recorder(tmp_path) as recorder, camera:
        run_replay(
            Config(),
            camera,
            FrameSource(camera),
            [recorder, LockstepOutput(recorder)],
            StopSignal(),
        )
    folder = wait_for_incident(tmp_path, "lost")
    replayed = tmp_path / "again.txt"
    outcome = run_in_process(capfd, "replay", folder, "--trajectory", replayed, "--no-publish")
    assert outcome.code == 0, outcome.err
    published = (folder / "trajectory.txt").read_text().splitlines()
    assert replayed.read_text().splitlines() == published[1:]
    assert len(published[1:]) == len(frames) - 1


def test_frames_from_before_a_driver_crash_are_kept(tmp_path: Path) -> None:
    (tmp_path / "script").touch()  # an empty script: the camera works
    make = partial(FileScriptedCamera, tmp_path / "script")
    driver = SubprocessCamera("scripted", Clock.MONOTONIC, make, PlaybackMode.REALTIME)
    with running_recorder(tmp_path) as recorder, driver as camera:
        frames = [camera.read(30.0) for _ in range(5)]
        send_updates(recorder, *(replace(make_update(0), frame=frame) for frame in frames))
        os.kill(frames[-1].lost_packets, signal.SIGKILL)
        send_updates(recorder, replace(make_update(0), frame=camera.read(30.0)))
        found = read_recording(save_incident(recorder, "command"))
    assert [is_intact(frame) for frame in found] == [True] * 6
