"""`run` with the odometry of the wheels: messages over Zenoh, warnings in the status."""

import time
from pathlib import Path

import pytest

from tests.vo_service.service_runner import CAMERA, service_runner
from tests.waiting import wait_until
from vo_service import PoseClient

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

WHEELS = "[wheel_odometry]\nenabled = true\n"


def test_a_message_that_is_none_is_a_warning_of_the_status(
    tmp_path: Path, render_cache: Path
) -> None:
    with service_runner(tmp_path, render_cache, WHEELS + CAMERA) as stage:
        received = stage.start().received

        def has_warning() -> bool:
            stage.session.put("kinect/wheel_odom", b"no odometry")
            return any(
                status.has_warning("wheel odometry: a message on kinect/wheel_odom is not used")
                for status in received.statuses
            )

        wait_until(has_warning)
        wait_until(lambda: bool(received.poses))
        stage.check()


def test_a_driver_that_comes_ends_the_warning_of_its_absence(
    tmp_path: Path, render_cache: Path
) -> None:
    with service_runner(tmp_path, render_cache, WHEELS + CAMERA) as stage:
        received = stage.start().received
        wait_until(
            lambda: any(
                status.has_warning("wheel odometry: no message on kinect/wheel_odom")
                for status in received.statuses
            )
        )
        with PoseClient(connect=f"tcp/127.0.0.1:{stage.port}") as base:

            def has_ended() -> bool:
                base.send_wheel_odometry(time.time(), 0.0, 0.0, 0.0)
                return not received.statuses[-1].has_warning("wheel odometry")

            wait_until(has_ended)
        stage.check()
