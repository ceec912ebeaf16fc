"""The whole service, from the Kinect's wire to the subscriber, through everything that goes wrong.

One service lives through all faults, one after another, in whatever order.
"""

import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.simulators.kinect_simulator import KinectModel, KinectSimulator, KinectStream
from tests.simulators.usb_frames import UsbFrames
from tests.vo_service.corner_sequence import (
    FRAMES,
    corner_pose,
    make_corner_kinect,
    write_corner_frames,
)
from tests.vo_service.sensor_faults import NO_KINECT_REASON, SENSOR_FAULTS, SensorFault, run_fault
from tests.vo_service.service_process import (
    NO_MAP_CONFIG,
    ONLY_POSES_CONFIG,
    ServiceProcess,
    running_service,
)
from tests.vo_service.subscriber import SubscribedPose

pytestmark = pytest.mark.usefixtures("real_libfreenect")

# How far apart two places of the sequence are at most, and what odometry may be off in between.
FILM_LENGTH_M = float(np.linalg.norm(corner_pose(FRAMES - 1)[:3, 3]))
DRIFT_M = 0.03
TICKS_PER_S = 60_000_000
WRAP_S = 2**32 / TICKS_PER_S


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> UsbFrames:
    """The sequence that every Kinect here plays."""
    return write_corner_frames(tmp_path_factory.mktemp("corner"))


@pytest.fixture(scope="module")
def kinect(
    sequence: UsbFrames, simulated_libusb: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[KinectSimulator]:
    """A 1414, plugged in."""
    with make_corner_kinect(tmp_path_factory.mktemp("kinect"), sequence) as kinect:
        kinect.waits_for_reader = True  # a machine that is busy is no fault of the service
        yield kinect


@pytest.fixture(scope="module")
def service(
    kinect: KinectSimulator, real_libfreenect: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServiceProcess]:
    """The service on it; it must live to the end, and then end in order."""
    folder = tmp_path_factory.mktemp("service")
    with running_service(folder, kinect.environment, more_config=NO_MAP_CONFIG) as service:
        service.wait_until_streaming(time.monotonic())
        yield service
        assert service.stop() == 0
    assert (kinect.open_handles, kinect.streaming) == (0, (False, False))


@pytest.fixture(scope="module")
def late_1473(
    sequence: UsbFrames, real_libfreenect: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServiceProcess]:
    """A service that was started before its Kinect was plugged in: a 1473 without firmware."""
    folder = tmp_path_factory.mktemp("late")
    with make_corner_kinect(folder, sequence, KinectModel.K1473) as kinect:
        kinect.waits_for_reader = True
        kinect.set_firmware_loaded(False)
        kinect.unplug()
        with running_service(folder, kinect.environment, more_config=ONLY_POSES_CONFIG) as service:
            service.wait_for_reason(NO_KINECT_REASON, 0.0)
            kinect.plug()
            service.wait_until_streaming(time.monotonic())
            yield service
            kinect.unplug()
            service.wait_for_reason(NO_KINECT_REASON, time.monotonic())
            assert service.stop() == 0


@pytest.mark.subprocess
@pytest.mark.zenoh
@pytest.mark.parametrize("fault", SENSOR_FAULTS, ids=lambda fault: fault.name.replace(" ", "-"))
def test_a_sensor_fault_is_reported_and_leaves_nothing_behind(
    fault: SensorFault, kinect: KinectSimulator, service: ServiceProcess
) -> None:
    service.wait_until_streaming(time.monotonic())
    before, so_far = service.resources_in_use(), len(service.received.poses)
    run_fault(fault, kinect, service)
    check_poses(service.received.poses[max(0, so_far - 1) :])
    service.wait_for_status(lambda _: service.resources_in_use() <= before)


def test_frames_with_lost_packets_are_counted_and_skipped(
    kinect: KinectSimulator, service: ServiceProcess
) -> None:
    service.wait_until_streaming(time.monotonic())
    before, so_far = service.status, len(service.received.poses)
    for stream, every in ((KinectStream.DEPTH, 601), (KinectStream.COLOR, 407)):
        kinect.lose_packets(stream, every)
    service.wait_for_status(
        lambda status: (
            status["camera"]["skipped"] >= before["camera"]["skipped"] + 10
            and len(service.received.poses) > so_far + 5
        )
    )
    for stream in KinectStream:
        kinect.lose_packets(stream, 0)
    assert service.status["camera"]["lost_packets"] >= before["camera"]["lost_packets"] + 10
    poses = service.received.poses[so_far:]
    assert len(poses) > 5
    check_poses(poses)


def test_a_kinect_with_a_lower_rate_is_tracked(
    kinect: KinectSimulator, service: ServiceProcess
) -> None:
    service.wait_until_streaming(time.monotonic())
    so_far = len(service.received.poses)
    plugged_in_again_at(10, kinect, service)
    service.wait_for_status(
        lambda status: status["state"] == "tracking" and 1.0 < status["latency"]["fps"] < 12.0
    )
    plugged_in_again_at(30, kinect, service)
    check_poses(service.received.poses[so_far:])


def plugged_in_again_at(rate: int, kinect: KinectSimulator, service: ServiceProcess) -> None:
    """The rate can only be set before it streams."""
    kinect.unplug()
    service.wait_for_reason(NO_KINECT_REASON, time.monotonic())
    kinect.rate = rate
    kinect.plug()
    service.wait_until_streaming(time.monotonic())


def test_the_wrap_of_the_kinect_clock_has_no_effect(
    kinect: KinectSimulator, service: ServiceProcess
) -> None:
    service.wait_until_streaming(time.monotonic())
    kinect.unplug()
    service.wait_for_reason(NO_KINECT_REASON, time.monotonic())
    kinect.start_ticks = 2**32 - TICKS_PER_S // 2
    so_far = len(service.received.poses)
    kinect.plug()
    service.wait_for_status(lambda _: len(service.received.poses) >= so_far + 40)
    kinect.start_ticks = 0
    poses = service.received.poses[so_far:]
    assert poses[-1].stamp_s - poses[0].stamp_s > 1.0
    assert max(b.stamp_s - a.stamp_s for a, b in pairwise(poses)) < WRAP_S / 2
    check_poses(poses)


@pytest.mark.subprocess
@pytest.mark.zenoh
def test_a_service_started_before_its_kinect_waits_for_it(late_1473: ServiceProcess) -> None:
    first_pose_s = late_1473.received.poses[0].receive_time_s
    waited = [
        status for status in late_1473.received.statuses if status.receive_time_s < first_pose_s
    ]
    assert any(status.has_camera_reason(NO_KINECT_REASON) for status in waited)
    check_poses(late_1473.received.poses)


def test_a_1473_without_firmware_streams_and_its_status_has_the_limitation(
    late_1473: ServiceProcess,
) -> None:
    late_1473.wait_for_status(lambda status: status["state"] == "tracking")
    assert late_1473.status["level"]["source"] == "assumed"
    assert "firmware" in late_1473.log


def check_poses(poses: list[SubscribedPose]) -> None:
    """Finite, in order, with stamps that rise, and no step that the sequence does not have."""
    assert all(pose.is_finite for pose in poses)
    for before, after in pairwise(poses):
        assert after.seq > before.seq
        assert after.stamp_s > before.stamp_s
        if after.epoch == before.epoch:
            step_m = np.linalg.norm(after.position_m - before.position_m)
            assert step_m < FILM_LENGTH_M + DRIFT_M
