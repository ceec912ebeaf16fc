"""`run` with the odometry of the wheels: messages over Zenoh, warnings in the status."""

from pathlib import Path

import pytest

from tests.vo_service.service_runner import CAMERA, service_runner
from tests.waiting import wait_until

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


def test_nothing_is_subscribed_unless_it_is_enabled(tmp_path: Path, render_cache: Path) -> None:
    with service_runner(tmp_path, render_cache) as stage:
        received = stage.start().received
        wait_until(lambda: bool(received.poses))
        publisher = stage.session.declare_publisher("kinect/wheel_odom")
        assert not publisher.matching_status.matching  # type: ignore[attr-defined]
