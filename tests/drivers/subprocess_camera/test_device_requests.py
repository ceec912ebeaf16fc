"""Tilt and light of a camera in another process: never waited for, never forgotten."""

import logging
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import CameraState, Led
from drivers.core import CameraError
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.drivers.subprocess_camera.conftest import LONG_TIMEOUTS, MakeSubprocessCamera
from tests.drivers.subprocess_camera.scripted_cameras import FileScriptedCamera
from tests.drivers.subprocess_camera.scripted_motor import STUCK_DEG, MotorizedCamera, action_log
from tests.resource_leaks import child_pids
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
def motorized_camera(make_subprocess_camera: MakeSubprocessCamera) -> SubprocessCamera:
    """Streaming."""
    camera = make_subprocess_camera(MotorizedCamera, limits=AT_ONCE)
    camera.open()
    wait_until_streaming(camera)
    return camera


def test_requests_are_applied_to_a_streaming_camera(
    motorized_camera: SubprocessCamera, script: Path
) -> None:
    motorized_camera.set_tilt_deg(12.5)
    wait_for_done(script, "tilt 12.5")
    motorized_camera.set_led(Led.BLINK_GREEN)
    wait_for_done(script, "tilt 12.5", "light blink-green")
    assert motorized_camera.has_motor
    motorized_camera.read(100.0)


def test_requests_are_applied_again_by_the_next_driver_process(
    motorized_camera: SubprocessCamera, script: Path
) -> None:
    motorized_camera.set_tilt_deg(5.0)
    motorized_camera.set_tilt_deg(8.0)
    wait_for_done(script, "tilt 5", "tilt 8")
    (driver,) = child_pids()
    os.kill(driver, signal.SIGKILL)
    wait_for_done(script, "tilt 5", "tilt 8", "tilt 8")


def test_requests_are_applied_again_at_the_next_opening(
    motorized_camera: SubprocessCamera, script: Path
) -> None:
    motorized_camera.set_led(Led.RED)
    wait_for_done(script, "light red")
    motorized_camera.close()
    motorized_camera.open()
    wait_for_done(script, "light red", "light red")


def test_a_missing_camera_refuses_at_once_and_applies_the_request_when_back(
    motorized_camera: SubprocessCamera, script: Path
) -> None:
    script.write_text("absent")
    wait_until(lambda: motorized_camera.status.state is CameraState.ABSENT)
    with pytest.raises(
        CameraError, match=r"not open now \(absent: no scripted camera found; plug one in\)"
    ):
        motorized_camera.set_tilt_deg(3.0)
    assert done(script) == []
    script.write_text("")
    wait_until(lambda: "tilt 3" in done(script))


def test_a_camera_that_was_never_opened_applies_requests_when_opened(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    camera = make_subprocess_camera(MotorizedCamera)
    with pytest.raises(CameraError, match="scripted: not open now"):
        camera.set_led(Led.GREEN)
    camera.open()
    wait_for_done(script, "light green")


def test_a_blocked_tilt_motor_is_logged(
    motorized_camera: SubprocessCamera, script: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        motorized_camera.set_tilt_deg(STUCK_DEG)
        wait_until(lambda: "the scripted camera's neck is stuck" in caplog.text)
    motorized_camera.set_led(Led.OFF)
    wait_for_done(script, "light off")
    motorized_camera.read(100.0)


def test_a_camera_without_a_motor_unit_refuses(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    with make_subprocess_camera(FileScriptedCamera) as camera:
        wait_until_streaming(camera)
        with pytest.raises(CameraError, match="scripted: it has no motor"):
            camera.set_tilt_deg(1.0)
        with pytest.raises(CameraError, match="scripted: it has no LED"):
            camera.set_led(Led.RED)


def test_a_thousand_requests_cause_no_fault(
    motorized_camera: SubprocessCamera, script: Path
) -> None:
    for n in range(1000):
        motorized_camera.set_tilt_deg(float(n % 20))
    motorized_camera.set_led(Led.YELLOW)
    wait_until(lambda: done(script)[-1:] == ["light yellow"])
    assert len(done(script)) == 1001
    motorized_camera.read(100.0)
