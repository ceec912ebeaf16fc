"""Messages that cannot be parsed are ignored and reported."""

import pytest

from tests.vo_service.client.fake_service import FakeService, publish_and_receive
from tests.waiting import wait_until
from vo_service import PoseClient, PoseUnavailable, PoseUnavailableReason

pytestmark = pytest.mark.zenoh


@pytest.mark.parametrize(
    ("payload", "attachment", "message"),
    [
        (b"nonsense", b'{"schema": 1, "seq": 1, "state": "lost", "epoch": 0, "reason": ""}', "CDR"),
        (b"", None, "without its attachment"),
        (b"", b"\xff", "utf"),
        (b"", b'{"schema": 1, "seq": 1}', "without epoch, reason, state"),
        (
            b"",
            b'{"schema": 1, "seq": "a", "state": "lost", "epoch": 0, "reason": ""}',
            "a str for seq",
        ),
        (b"", b"[" * 100_000, "nested too deeply"),
        (b"", b'{"schema": 2}', "a message has version 2, but this client reads only 1"),
    ],
)
def test_an_unreadable_pose_is_logged_and_the_next_one_read(
    service: FakeService, client: PoseClient, payload: bytes, attachment: bytes | None, message: str
) -> None:
    service.publish_raw(payload, attachment)
    wait_until(lambda: client._state.parse_error != "")
    with pytest.raises(PoseUnavailable, match=message) as caught:
        client.newest()
    assert caught.value.reason is PoseUnavailableReason.UNREADABLE
    assert publish_and_receive(service, client.poses(), 60).seq == 60


@pytest.mark.parametrize(
    ("status", "message"),
    [
        (b'{"schema": 1}', "a status came without paused, reason, state"),
        (b'{"schema": 1, "state": "lost", "reason": "", "paused": 1}', "a int for paused"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_an_unreadable_status_is_reported_until_the_next_one(
    service: FakeService, client: PoseClient, status: bytes, message: str
) -> None:
    service.publish_raw_status(status)
    wait_until(lambda: client._state.parse_error != "")
    with pytest.raises(PoseUnavailable, match=message) as caught:
        client.newest()
    assert caught.value.reason is PoseUnavailableReason.UNREADABLE
    service.publish_status(paused=True)
    wait_until(lambda: client._state.parse_error == "")
    with pytest.raises(PoseUnavailable, match="the service is paused"):
        client.newest()


def test_a_status_does_not_hide_unreadable_poses(service: FakeService, client: PoseClient) -> None:
    service.publish_raw(b"nonsense")
    wait_until(lambda: client._state.parse_error != "")
    service.publish_status()
    wait_until(lambda: client._state.status.item is not None)
    with pytest.raises(PoseUnavailable, match="without its attachment") as caught:
        client.newest()
    assert caught.value.reason is PoseUnavailableReason.UNREADABLE
