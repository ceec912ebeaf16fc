"""Reading poses: the newest, how many were missed, and continuity."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.vo_service.client.fake_service import (
    FakeService,
    publish_and_receive,
    set_reply,
    wait_for_pose,
)
from tests.waiting import wait_until
from vo_service import Pose, PoseClient, PoseUnavailable, PoseUnavailableReason, ServiceUnavailable

pytestmark = pytest.mark.zenoh


def test_a_pose_has_all_fields_of_the_message(service: FakeService, client: PoseClient) -> None:
    pose = publish_and_receive(
        service, client.poses(), 7, x_m=1.5, epoch=2, state="degraded", reason="few"
    )
    assert (pose.stamp_s, pose.frame_id, pose.child_frame_id) == (12.5, "odom", "base_link")
    assert (pose.seq, pose.epoch, pose.state, pose.reason) == (7, 2, "degraded", "few")
    np.testing.assert_allclose(pose.position_m, [1.5, 0.5, -0.25])
    np.testing.assert_allclose(pose.quaternion_xyzw, [0, 0, 0, 1])
    assert pose.pose_covariance.shape == pose.twist_covariance.shape == (6, 6)
    assert 0 <= pose.age_s < 20


def test_a_slow_reader_gets_the_newest_pose_and_the_number_of_missed_ones(
    service: FakeService, client: PoseClient
) -> None:
    poses = client.poses()
    publish_and_receive(service, poses, 10)
    for seq in range(11, 31):
        service.publish_pose(seq)
    wait_for_pose(client, 30)
    pose = next(poses)
    assert (pose.seq, pose.missed, pose.is_continuous) == (30, 19, True)


def test_each_reader_has_its_own_count(service: FakeService, client: PoseClient) -> None:
    one, other = client.poses(), client.poses()
    publish_and_receive(service, one, 1)
    service.publish_pose(2)
    assert (next(one).missed, next(other).missed) == (0, 0)
    assert publish_and_receive(service, one, 3).is_continuous


@pytest.mark.parametrize(
    ("seq", "epoch"), [(6, 1), (0, 0)], ids=["another epoch", "numbers from 0 again"]
)
def test_a_discontinuous_pose_is_marked(
    service: FakeService, client: PoseClient, seq: int, epoch: int
) -> None:
    poses = client.poses()
    assert not publish_and_receive(service, poses, 4).is_continuous
    assert publish_and_receive(service, poses, 5).is_continuous
    assert not publish_and_receive(service, poses, seq, epoch=epoch).is_continuous


def test_the_newest_pose_is_available_at_once(service: FakeService, client: PoseClient) -> None:
    service.publish_pose(40, x_m=4.0)
    wait_for_pose(client, 40)
    assert client.newest(max_age_s=20).position_m[0] == 4.0
    again = client.newest(max_age_s=20)
    assert (again.seq, again.missed, again.is_continuous) == (40, 0, True)


def test_an_old_pose_is_not_returned_as_the_newest(
    service: FakeService, client: PoseClient
) -> None:
    service.publish_pose(41)
    wait_for_pose(client, 41)
    service.publish_status()
    wait_until(lambda: client._state.status.item is not None)
    with pytest.raises(
        PoseUnavailable, match=r"no pose for \d+\.\d s, but the service reports"
    ) as caught:
        client.newest(max_age_s=1e-6)
    assert caught.value.reason is PoseUnavailableReason.SILENT
    assert caught.value.last is not None
    assert caught.value.last.seq == 41


@pytest.mark.parametrize(
    ("status", "why", "message"),
    [
        ({"paused": True, "state": "lost"}, PoseUnavailableReason.PAUSED, "the service is paused"),
        (
            {"state": "no_camera", "reason": "unplugged"},
            PoseUnavailableReason.NO_CAMERA,
            "no camera: unplugged",
        ),
        (
            {"state": "lost", "reason": "too dark"},
            PoseUnavailableReason.LOST,
            "tracking is lost: too dark",
        ),
    ],
)
def test_the_status_gives_the_reason_for_missing_poses(
    service: FakeService,
    client: PoseClient,
    status: dict[str, object],
    why: PoseUnavailableReason,
    message: str,
) -> None:
    service.publish_status(**status)
    wait_until(lambda: client._state.status.item is not None)
    with pytest.raises(PoseUnavailable, match=message) as caught:
        client.newest()
    assert (caught.value.reason, caught.value.last) == (why, None)


def test_a_lost_pose_is_an_error_that_contains_it(service: FakeService, client: PoseClient) -> None:
    pose = publish_and_receive(
        service, client.poses(), 50, state="lost", reason="3 of 9 matches agree"
    )
    assert pose.is_lost
    with pytest.raises(PoseUnavailable, match="tracking is lost: 3 of 9 matches agree") as caught:
        client.newest(max_age_s=20)
    assert caught.value.reason is PoseUnavailableReason.LOST
    assert caught.value.last is not None


def test_without_any_message_the_reason_is_silent(client: PoseClient) -> None:
    with pytest.raises(PoseUnavailable, match="is up but publishes nothing"):
        client.newest()


def test_waiting_for_a_pose_can_time_out(client: PoseClient) -> None:
    with pytest.raises(PoseUnavailable) as caught:
        next(client.poses(timeout_s=0.05))
    assert caught.value.reason is PoseUnavailableReason.SILENT


def test_each_thread_gets_the_discontinuity(service: FakeService, client: PoseClient) -> None:
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
        seen = []
        for seq, epoch in ((70, 0), (71, 0), (72, 1), (73, 1)):
            service.publish_pose(seq, epoch=epoch)
            wait_for_pose(client, seq)
            poses = [thread.submit(client.newest, 60.0).result() for thread in (one, other)]
            seen.append([pose.is_continuous for pose in poses])
    assert seen == [[False, False], [True, True], [False, False], [True, True]]


def test_closing_ends_the_readers(client: PoseClient) -> None:
    ended: list[list[Pose]] = []
    reader = threading.Thread(target=lambda: ended.append(list(client.poses())))
    reader.start()
    client.close()
    client.close()
    reader.join(100)
    assert ended == [[]]


def test_a_closed_client_has_nothing_of_the_service(
    service: FakeService, client: PoseClient
) -> None:
    publish_and_receive(service, client.poses(), 51)
    service.publish_status(state="tracking")
    wait_until(lambda: client._state.status.item is not None)
    client.close()
    assert not client.is_alive
    with pytest.raises(ServiceUnavailable, match="this client is closed"):
        client.status()
    with pytest.raises(PoseUnavailable, match="this client is closed"):
        client.newest(max_age_s=0.0)


def test_statuses_also_return_the_newest(service: FakeService, client: PoseClient) -> None:
    statuses = client.statuses()
    service.publish_status(state="degraded")
    assert next(statuses)["state"] == "degraded"
    assert client.status()["state"] == "degraded"


def test_the_first_status_of_a_service_that_starts_is_waited_for(
    service: FakeService, client: PoseClient
) -> None:
    refusal = {"error": "not-possible", "message": "there is no status yet"}
    queries = set_reply(service, client, "status", refusal)
    with ThreadPoolExecutor() as pool:
        status = pool.submit(client.status, 100.0)
        wait_until(lambda: bool(queries))
        service.publish_status(state="no_camera")
        assert status.result()["state"] == "no_camera"
