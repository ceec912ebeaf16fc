"""The client with the project's own files for TLS, against a robot with rules."""

import pytest
import zenoh

from tests.vo_service.security.conftest import keys, network, robot
from tests.vo_service.security.tls_network import TlsNetwork, TlsRobot, running_robot
from tests.waiting import wait_until
from vo_service import PoseClient, PoseUnavailable, PoseUnavailableReason, ServiceUnavailable
from vo_service.client import connection
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

pytestmark = pytest.mark.zenoh

__all__ = ["keys", "network", "robot"]


@pytest.mark.subprocess
def test_a_reader_gets_poses_but_no_reply_to_a_command(
    network: TlsNetwork, robot: TlsRobot
) -> None:
    with PoseClient(config_file=network.file("reader-tls.json5", "ours/reader")) as client:
        assert next(client.poses(timeout_s=100)).state == "tracking"
        assert client.query_latest().state == "tracking"
        assert client.map_odom().map_keyframes == 4
        with pytest.raises(ServiceUnavailable):
            client.command("pause", timeout_s=1.0)
    assert robot.executed == []


def test_a_missing_robot_is_awaited_and_reconnected(network: TlsNetwork) -> None:
    with PoseClient(config_file=network.file("reader-tls.json5", "ours/reader")) as client:
        with pytest.raises(PoseUnavailable) as caught:
            client.newest()
        assert caught.value.reason is PoseUnavailableReason.NO_PUBLISHER
        for _ in range(2):
            with running_robot(network):
                assert next(client.poses(timeout_s=100)).state == "tracking"


def test_a_missing_key_file_is_logged_once_and_awaited(
    network: TlsNetwork, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "RETRY_S", 0.05)
    attempts = count_attempts(monkeypatch)
    file = network.file("reader-tls.json5", "ours/reader")
    certificate = file.with_name("tls.pem")
    with PoseClient(config_file=file) as client:
        certificate.rename(file.with_name("away.pem"))
        before = len(attempts)
        wait_until(lambda: len(attempts) > before + 3)
        file.with_name("away.pem").rename(certificate)
        with running_robot(network):
            assert next(client.poses(timeout_s=100)).state == "tracking"
    messages = [
        record.getMessage() for record in caplog.records if "tls.pem" in record.getMessage()
    ]
    assert len(messages) == 1
    assert messages[0].endswith("; trying again")


def count_attempts(monkeypatch: pytest.MonkeyPatch) -> list[ZenohConfig]:
    """Return a list that grows with every attempt to open a session."""
    attempts: list[ZenohConfig] = []

    def open_and_count(config: ZenohConfig, max_message_bytes: int) -> zenoh.Session:
        attempts.append(config)
        return open_session(config, max_message_bytes)

    monkeypatch.setattr(connection, "open_session", open_and_count)
    return attempts


def test_a_refused_client_gets_nothing_and_a_hint_why(network: TlsNetwork, robot: TlsRobot) -> None:
    file = network.file("operator-tls.json5", "strange/operator")
    with PoseClient(config_file=file) as client, pytest.raises(PoseUnavailable) as caught:
        next(client.poses(timeout_s=1.0))
    assert caught.value.reason is PoseUnavailableReason.NO_PUBLISHER
    assert (
        f"no kinect-vo publishes as kinect at the endpoints in {file}, or access is denied"
        in str(caught.value)
    )
