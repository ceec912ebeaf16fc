"""`run` with a camera on a simulated base: a program drives it over Zenoh."""

from pathlib import Path

import pytest

from tests.vo_service.service_runner import CAMERA, service_runner
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service import PoseClient

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

DRIVEN = CAMERA.replace('motion = "still"', 'motion = "driven"\nrate_hz = 10.0') + (
    "[base]\nplanar = true\n"
    "[T_base_camera]\n"
    "translation_m = [0.0, 0.0, 0.5]\n"
    "quaternion_xyzw = [-0.5417, 0.5417, -0.4545, 0.4545]\n"
)


def test_a_program_drives_and_reads_where_the_base_is(tmp_path: Path, render_cache: Path) -> None:
    with service_runner(tmp_path, render_cache, DRIVEN) as stage:
        received = stage.start().received
        with PoseClient(connect=f"tcp/127.0.0.1:{stage.port}") as client:
            for pose in client.poses(timeout_s=DEFAULT_TIMEOUT_S):
                client.send_velocity(0.2, 0.0)
                if pose.position_m[0] > 0.2:
                    break
            assert abs(pose.position_m[1]) < 0.03
        wait_until(lambda: bool(received.poses))

        def has_warning() -> bool:
            stage.session.put("kinect/cmd_vel", b"no velocity")
            return any(
                status.has_warning("simulated base: stopped") for status in received.statuses
            )

        wait_until(has_warning)
        stage.check()


def test_velocities_and_wheels_are_not_subscribed_unless_they_are_used(
    tmp_path: Path, render_cache: Path
) -> None:
    with service_runner(tmp_path, render_cache) as stage:
        received = stage.start().received
        wait_until(lambda: bool(received.poses))
        for name in ("cmd_vel", "wheel_odom"):
            publisher = stage.session.declare_publisher(f"kinect/{name}")
            assert not publisher.matching_status.matching  # type: ignore[attr-defined]
