"""The client of images and points, against the service's own outputs."""

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.core import InputError
from tests.ports import free_port
from tests.vo_service.outputs.frames.frame_robot import (
    T_BASE_CAMERA,
    Robot,
    running_robot,
)
from tests.vo_service.outputs.sample_updates import STATUS
from tests.waiting import wait_until
from vo_service import FrameClient, FrameUnavailable
from vo_service.config_tables import ScanConfig
from vo_service.navigation.robot_scan import RobotScanner
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def robot(port: int) -> Iterator[Robot]:
    with running_robot(port) as made:
        yield made


@pytest.fixture
def client(robot: Robot, port: int) -> Iterator[FrameClient]:
    with FrameClient(connect=f"tcp/127.0.0.1:{port}") as opened:
        yield opened


class Publishing:
    """Publishes updates on a thread, 30 a second, and keeps them by number."""

    def __init__(self, robot: Robot) -> None:
        self.updates: dict[int, OdometryUpdate] = {}
        self._robot = robot
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Publishing":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(1 / 30):
            update = self._robot.publish()
            self.updates[update.seq] = update


def test_a_frame_has_images_intrinsics_and_the_pose_of_its_stamp(
    client: FrameClient, robot: Robot
) -> None:
    with Publishing(robot) as publishing:
        frame = next(client.frames(timeout_s=60.0))
        wait_until(lambda: frame.seq in publishing.updates)
    update = publishing.updates[frame.seq]
    np.testing.assert_array_equal(frame.color_bgr, update.frame.color_bgr)
    np.testing.assert_allclose(frame.depth_m, update.frame.depth_m, atol=0.00051)
    np.testing.assert_array_equal(frame.K, update.frame.camera.K)
    np.testing.assert_allclose(frame.pose.T_odom_base, update.T_odom_base, atol=1e-9)
    np.testing.assert_array_equal(frame.pose.pose_covariance, update.pose_covariance)
    np.testing.assert_allclose(frame.T_odom_camera, update.T_odom_base @ T_BASE_CAMERA, atol=1e-9)
    assert frame.stamp_s == pytest.approx(update.stamp_s, abs=1e-9)


def test_compressed_frames_are_decoded_when_they_are_used(
    client: FrameClient, robot: Robot
) -> None:
    with Publishing(robot) as publishing:
        frame = next(client.frames(timeout_s=60.0, compressed=True))
        wait_until(lambda: frame.seq in publishing.updates)
    sent = publishing.updates[frame.seq].frame
    np.testing.assert_allclose(frame.depth_m, sent.depth_m, atol=0.00051)
    assert frame.color_bgr.shape == sent.color_bgr.shape
    assert frame.color_jpeg[:2] == b"\xff\xd8"


def test_depth_that_was_not_asked_for_is_not_sent(client: FrameClient, robot: Robot) -> None:
    with Publishing(robot):
        frames = client.frames(timeout_s=60.0, depth=False)
        frame = next(frames)
        assert not robot.is_wanted("depth/image")
        frames.close()  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="depth=True"):
        _ = frame.depth_mm
    with pytest.raises(ValueError, match="compressed=True"):
        _ = frame.color_jpeg


def test_points_lie_where_the_pose_says(client: FrameClient, robot: Robot) -> None:
    with Publishing(robot) as publishing:
        cloud = next(client.points(timeout_s=60.0))
        wait_until(lambda: cloud.seq in publishing.updates)
    update = publishing.updates[cloud.seq]
    T = update.T_odom_base @ T_BASE_CAMERA
    expected = cloud.xyz_m.astype(float) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(cloud.xyz_odom_m, expected, atol=1e-6)
    assert cloud.rgb.shape == cloud.xyz_m.shape
    assert len(cloud.xyz_m) == np.count_nonzero(update.frame.depth_raw[::2, ::2])


def test_a_scan_has_directions_and_the_nearest_obstacles(client: FrameClient, robot: Robot) -> None:
    with Publishing(robot) as publishing:
        scan = next(client.scans(timeout_s=60.0))
        wait_until(lambda: scan.seq in publishing.updates)
    update = publishing.updates[scan.seq]
    scanner = RobotScanner(ScanConfig(), T_BASE_CAMERA)
    angles, ranges_m = scanner.scan(update.frame, update.T_odom_camera)
    np.testing.assert_array_equal(scan.ranges_m, ranges_m)
    assert scan.angles_rad[[0, -1]] == pytest.approx(
        [angles.first_rad, angles.first_rad + (angles.bins - 1) * angles.step_rad], abs=1e-5
    )


def test_a_slow_reader_gets_the_newest_frame(client: FrameClient, robot: Robot) -> None:
    with Publishing(robot) as publishing:
        frames = client.frames(timeout_s=60.0)
        first = next(frames)
        wait_until(lambda: len(publishing.updates) > first.seq + 20)
        second, third = next(frames), next(frames)
    assert third.seq > second.seq > first.seq
    assert third.seq >= first.seq + 15
    assert third.pose.missed < 20
    assert third.pose.is_continuous


def test_after_the_loop_nothing_is_sent(client: FrameClient, robot: Robot) -> None:
    with Publishing(robot):
        for _ in client.frames(timeout_s=60.0):
            break
        wait_until(lambda: not robot.is_wanted("color/image"))


def test_without_a_service_the_time_out_says_so() -> None:
    with (
        FrameClient(connect=f"tcp/127.0.0.1:{free_port()}") as client,
        pytest.raises(FrameUnavailable, match="no kinect-vo publishes there"),
    ):
        next(client.frames(timeout_s=0.05))


def test_a_service_without_frames_is_named(client: FrameClient, robot: Robot) -> None:
    robot.publish_status(STATUS)
    client._state.wait_until_alive(60.0)
    with pytest.raises(FrameUnavailable, match="sends no color/camera_info or color/image"):
        next(client.frames(timeout_s=0.05, depth=False))


def assert_close_ends_its_loop(client: FrameClient, is_waiting: Callable[[], object]) -> None:
    ended: list[object] = []
    thread = threading.Thread(target=lambda: ended.append(list(client.frames())))
    thread.start()
    wait_until(is_waiting)
    client.close()
    thread.join(60.0)
    assert ended == [[]]


def test_close_ends_a_loop(client: FrameClient, robot: Robot) -> None:
    assert_close_ends_its_loop(client, lambda: robot.is_wanted("color/image"))


def test_close_ends_a_loop_that_waits_for_a_service() -> None:
    client = FrameClient(connect=f"tcp/127.0.0.1:{free_port()}")
    assert_close_ends_its_loop(client, lambda: client._assemblies)


def test_a_closed_client_has_no_frames(client: FrameClient) -> None:
    client.close()
    assert list(client.frames()) == []


@pytest.mark.parametrize("call", [FrameClient.frames, FrameClient.points])
def test_a_bad_time_out_is_refused(
    client: FrameClient, call: Callable[..., Iterator[object]]
) -> None:
    with pytest.raises(InputError, match="timeout_s"):
        next(call(client, timeout_s=-1.0))
