"""The whole service, from the Kinect's wire to the subscriber, through everything that goes wrong.

One service lives through all faults, one after another, in whatever order.
"""

import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.stand_ins.played_kinect import Model, PlayedKinect, Stream
from tests.stand_ins.wire_film import WireFilm
from tests.vo_service.corner_film import FRAMES, corner_film, corner_kinect, corner_pose
from tests.vo_service.played_service import WITHOUT_MAP, PlayedService, running_service
from tests.vo_service.service_faults import FAULTS, GONE, ServiceFault, pass_through
from tests.vo_service.subscriber import HeardPose

pytestmark = pytest.mark.usefixtures("real_libfreenect")

# How far apart two places of the film are at most, and what odometry may be off in between.
FILM_LENGTH_M = float(np.linalg.norm(corner_pose(FRAMES - 1)[:3, 3]))
DRIFT_M = 0.03
TICKS_PER_S = 60_000_000
WRAP_S = 2**32 / TICKS_PER_S


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> WireFilm:
    """The film that every Kinect here plays."""
    return corner_film(tmp_path_factory.mktemp("corner"))


@pytest.fixture(scope="module")
def kinect(
    film: WireFilm, played_libusb: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[PlayedKinect]:
    """A 1414, plugged in."""
    with corner_kinect(tmp_path_factory.mktemp("kinect"), film) as kinect:
        kinect.patient = True  # a machine that is busy is no fault of the service
        yield kinect


@pytest.fixture(scope="module")
def service(
    kinect: PlayedKinect, real_libfreenect: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[PlayedService]:
    """The service on it; it must live to the end, and then end in order."""
    folder = tmp_path_factory.mktemp("service")
    with running_service(folder, kinect.environment, more_config=WITHOUT_MAP) as service:
        service.until_streaming(time.monotonic())
        yield service
        assert service.end() == 0
    assert (kinect.open_handles, kinect.streaming) == (0, (False, False))


@pytest.fixture(scope="module")
def late_1473(
    film: WireFilm, real_libfreenect: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[PlayedService]:
    """A service that was started before its Kinect was plugged in: a 1473 without firmware."""
    folder = tmp_path_factory.mktemp("late")
    with corner_kinect(folder, film, Model.K1473) as kinect:
        kinect.patient = True
        kinect.firmware(False)
        kinect.unplug()
        with running_service(folder, kinect.environment, more_config=WITHOUT_MAP) as service:
            service.until_said(GONE, 0.0)
            kinect.plug()
            service.until_streaming(time.monotonic())
            yield service
            kinect.unplug()
            service.until_said(GONE, time.monotonic())
            assert service.end() == 0


@pytest.mark.subprocess
@pytest.mark.zenoh
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name.replace(" ", "-"))
def test_a_fault_is_named_lived_through_and_leaves_nothing_behind(
    fault: ServiceFault, kinect: PlayedKinect, service: PlayedService
) -> None:
    service.until_streaming(time.monotonic())
    before, so_far = service.belongings(), len(service.heard.poses)
    pass_through(fault, kinect, service)
    check_poses(service.heard.poses[max(0, so_far - 1) :])
    service.until(lambda _: service.belongings() <= before)


def test_frames_that_lost_packets_are_counted_and_not_used(
    kinect: PlayedKinect, service: PlayedService
) -> None:
    service.until_streaming(time.monotonic())
    before, so_far = service.status, len(service.heard.poses)
    for stream, every in ((Stream.DEPTH, 601), (Stream.COLOUR, 407)):
        kinect.lose_packets(stream, every)
    service.until(
        lambda status: (
            status["skipped"] >= before["skipped"] + 10 and len(service.heard.poses) > so_far + 5
        )
    )
    for stream in Stream:
        kinect.lose_packets(stream, 0)
    assert service.status["lost_packets"] >= before["lost_packets"] + 10
    poses = service.heard.poses[so_far:]
    assert len(poses) > 5
    check_poses(poses)


def test_a_kinect_that_sends_fewer_frames_is_followed_at_its_own_pace(
    kinect: PlayedKinect, service: PlayedService
) -> None:
    service.until_streaming(time.monotonic())
    so_far = len(service.heard.poses)
    plugged_in_again_at(10, kinect, service)
    service.until(lambda status: status["state"] == "tracking" and 1.0 < status["fps"] < 12.0)
    plugged_in_again_at(30, kinect, service)
    check_poses(service.heard.poses[so_far:])


def plugged_in_again_at(rate: int, kinect: PlayedKinect, service: PlayedService) -> None:
    """The rate can only be set before it streams."""
    kinect.unplug()
    service.until_said(GONE, time.monotonic())
    kinect.rate = rate
    kinect.plug()
    service.until_streaming(time.monotonic())


def test_the_wrap_of_the_kinects_clock_is_not_seen(
    kinect: PlayedKinect, service: PlayedService
) -> None:
    service.until_streaming(time.monotonic())
    kinect.unplug()
    service.until_said(GONE, time.monotonic())
    kinect.start_ticks = 2**32 - TICKS_PER_S // 2
    so_far = len(service.heard.poses)
    kinect.plug()
    service.until(lambda _: len(service.heard.poses) >= so_far + 40)
    kinect.start_ticks = 0
    poses = service.heard.poses[so_far:]
    assert poses[-1].stamp_s - poses[0].stamp_s > 1.0
    assert max(b.stamp_s - a.stamp_s for a, b in pairwise(poses)) < WRAP_S / 2
    check_poses(poses)


@pytest.mark.subprocess
@pytest.mark.zenoh
def test_a_service_that_is_there_before_its_kinect_waits_for_it(late_1473: PlayedService) -> None:
    first_pose_s = late_1473.heard.poses[0].heard_s
    waited = [status for status in late_1473.heard.statuses if status.heard_s < first_pose_s]
    assert any(status.says(GONE) for status in waited)
    check_poses(late_1473.heard.poses)


def test_a_1473_without_firmware_streams_and_its_status_says_what_it_cannot_do(
    late_1473: PlayedService,
) -> None:
    late_1473.until(lambda status: status["state"] == "tracking")
    assert late_1473.status["level"] == "assumed"
    assert "firmware" in late_1473.log


def check_poses(poses: list[HeardPose]) -> None:
    """Finite, in order, with stamps that rise, and no step that the film does not have."""
    assert all(pose.is_finite for pose in poses)
    for before, after in pairwise(poses):
        assert after.seq > before.seq
        assert after.stamp_s > before.stamp_s
        if after.epoch == before.epoch:
            step_m = np.linalg.norm(after.position_m - before.position_m)
            assert step_m < FILM_LENGTH_M + DRIFT_M
