"""Tilt and light of a camera in another process: never waited for, never forgotten."""

import logging
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import CameraState
from drivers.errors import CameraError
from drivers.isolation.camera import SubprocessCamera
from drivers.sensor_settings import Led
from tests.belongings import child_pids
from tests.drivers.isolation.conftest import LONG_TIMEOUTS, MakeSubprocessCamera
from tests.drivers.isolation.nodding import STUCK_DEG, MotorizedCamera, action_log
from tests.drivers.isolation.trial_cameras import FileScriptedCamera
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

AT_ONCE = replace(LONG_TIMEOUTS, initial_retry_s=0.01, max_retry_s=0.01)


def done(script: Path) -> list[str]:
    path = action_log(script)
    return path.read_text().splitlines() if path.exists() else []


def wait_for_done(script: Path, *expected: str) -> None:
    wait_until(lambda: done(script) == list(expected), f"{expected}: {done(script)}")


def wait_until_streaming(camera: SubprocessCamera) -> None:
    """Frames come by another way than what is told of the camera, and may be there before it."""
    camera.read(100.0)
    wait_until(lambda: camera.status.state is CameraState.STREAMING, "to hear that it streams")


@pytest.fixture
def nodding(isolate: MakeSubprocessCamera) -> SubprocessCamera:
    """Streaming."""
    camera = isolate(MotorizedCamera, limits=AT_ONCE)
    camera.open()
    wait_until_streaming(camera)
    return camera


def test_a_camera_that_streams_does_as_it_is_told(nodding: SubprocessCamera, script: Path) -> None:
    nodding.set_tilt_deg(12.5)
    wait_for_done(script, "tilt 12.5")
    nodding.set_led(Led.BLINK_GREEN)
    wait_for_done(script, "tilt 12.5", "light blink-green")
    assert nodding.has_motor
    nodding.read(100.0)


def test_what_was_asked_for_is_done_again_by_the_next_driver(
    nodding: SubprocessCamera, script: Path
) -> None:
    nodding.set_tilt_deg(5.0)
    nodding.set_tilt_deg(8.0)
    wait_for_done(script, "tilt 5", "tilt 8")
    (driver,) = child_pids()
    os.kill(driver, signal.SIGKILL)
    wait_for_done(script, "tilt 5", "tilt 8", "tilt 8")


def test_what_was_asked_for_is_done_again_when_it_is_opened_again(
    nodding: SubprocessCamera, script: Path
) -> None:
    nodding.set_led(Led.RED)
    wait_for_done(script, "light red")
    nodding.close()
    nodding.open()
    wait_for_done(script, "light red", "light red")


def test_a_camera_that_is_away_says_so_at_once_and_does_it_when_it_is_back(
    nodding: SubprocessCamera, script: Path
) -> None:
    script.write_text("absent")
    wait_until(lambda: nodding.status.state is CameraState.ABSENT)
    with pytest.raises(CameraError, match=r"not open now \(absent: no puppet found; plug one in\)"):
        nodding.set_tilt_deg(3.0)
    assert done(script) == []
    script.write_text("")
    wait_until(lambda: "tilt 3" in done(script))


def test_a_camera_that_was_never_opened_does_it_then(
    isolate: MakeSubprocessCamera, script: Path
) -> None:
    camera = isolate(MotorizedCamera)
    with pytest.raises(CameraError, match="puppet: not open now"):
        camera.set_led(Led.GREEN)
    camera.open()
    wait_for_done(script, "light green")


def test_a_head_that_is_stuck_is_said_in_the_log(
    nodding: SubprocessCamera, script: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        nodding.set_tilt_deg(STUCK_DEG)
        wait_until(lambda: "the puppet's neck is stuck" in caplog.text)
    nodding.set_led(Led.OFF)
    wait_for_done(script, "light off")
    nodding.read(100.0)


def test_a_camera_without_a_base_refuses(isolate: MakeSubprocessCamera) -> None:
    with isolate(FileScriptedCamera) as camera:
        wait_until_streaming(camera)
        with pytest.raises(CameraError, match="puppet: it has no motor"):
            camera.set_tilt_deg(1.0)
        with pytest.raises(CameraError, match="puppet: it has no light"):
            camera.set_led(Led.RED)


def test_a_thousand_wishes_are_no_trouble(nodding: SubprocessCamera, script: Path) -> None:
    for n in range(1000):
        nodding.set_tilt_deg(float(n % 20))
    nodding.set_led(Led.YELLOW)
    wait_until(lambda: done(script)[-1:] == ["light yellow"])
    assert len(done(script)) == 1001
    nodding.read(100.0)
