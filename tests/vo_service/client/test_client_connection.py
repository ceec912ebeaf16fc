"""Services that start late, stop and return; what importing the client loads."""

from pathlib import Path

import pytest

from drivers.core import InputError
from tests.vo_service.client.fake_service import (
    find_free_endpoint,
    running_fake_service,
    wait_for_pose,
)
from tests.waiting import wait_until
from vo_service import PoseClient, PoseUnavailable, PoseUnavailableReason

pytestmark = pytest.mark.zenoh


def test_the_client_waits_for_the_service() -> None:
    endpoint = find_free_endpoint()
    with PoseClient(connect=endpoint) as client:
        assert not client.wait_for_publisher(0.05)
        with pytest.raises(
            PoseUnavailable, match=f"no kinect-vo publishes as kinect at {endpoint}"
        ) as no:
            client.newest()
        assert no.value.reason is PoseUnavailableReason.NO_PUBLISHER
        with running_fake_service(endpoint) as publisher:
            assert client.wait_for_publisher(20)
            publisher.wait_for_reader()
            poses = client.poses(timeout_s=100)
            publisher.publish_pose(1)
            assert next(poses).seq == 1


def test_a_service_that_is_not_there_is_announced(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(PoseClient, "ANNOUNCE_AFTER_S", 0.05)
    endpoint = find_free_endpoint()
    with PoseClient(connect=endpoint):
        wait_until(lambda: bool(caplog.messages))
    assert caplog.messages == [f"waiting: no kinect-vo publishes as kinect at {endpoint}"]


def test_after_a_restart_poses_are_read_again_but_not_continuous() -> None:
    endpoint = find_free_endpoint()
    with PoseClient(connect=endpoint) as client:
        seen = []
        for first, x_m in ((5, 1.0), (7, 2.0)):
            with running_fake_service(endpoint) as publisher:
                publisher.wait_for_reader()
                assert client.wait_for_publisher(20)
                for seq in (first, first + 1):
                    publisher.publish_pose(seq, x_m)
                    wait_for_pose(client, seq)
                    pose = client.newest(max_age_s=20)
                    seen.append((pose.position_m[0], pose.is_continuous))
            wait_until(lambda: not client.is_alive)
            with pytest.raises(PoseUnavailable) as caught:
                client.newest(max_age_s=0.0)
            assert caught.value.reason is PoseUnavailableReason.NO_PUBLISHER
    assert seen == [(1.0, False), (1.0, True), (2.0, False), (2.0, True)]


def test_a_zenoh_configuration_sets_the_endpoint(tmp_path: Path) -> None:
    endpoint, file = find_free_endpoint(), tmp_path / "reader.json5"
    file.write_text(f"{{connect: {{endpoints: ['{endpoint}']}}}}")
    with running_fake_service(endpoint), PoseClient(config_file=file) as client:
        assert client.wait_for_publisher(20)


@pytest.mark.parametrize(
    "invalid_argument",
    [{"prefix": "/x"}, {"connect": "nonsense"}, {"config_file": "missing.json5"}],
)
def test_configuration_errors_are_raised_at_once(invalid_argument: dict[str, str]) -> None:
    with pytest.raises(InputError):
        PoseClient(**invalid_argument)
