"""What a client sends for each command, and how it handles the replies."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from drivers.camera import Led
from drivers.core.geometry import rigid_transform
from tests.vo_service.client.fake_service import FakeService, running_fake_service, set_reply
from tests.waiting import wait_until
from vo_service import CommandRefused, PoseClient, ServiceUnavailable
from vo_service.types.commands import (
    COMMANDS,
    Command,
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ResetCommand,
    ResumeCommand,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
    parse_command,
)

pytestmark = pytest.mark.zenoh

FOLDER = {"folder": "/var/lib/kinect-vo/desk"}
T_ODOM_BASE = rigid_transform(np.eye(3), [1.0, 2.0, 0.5])
# By name: a command and the reply to it.
EXCHANGES: dict[str, tuple[Command, dict[str, Any]]] = {
    "reset": (ResetCommand.to_pose(T_ODOM_BASE), {"epoch": 4}),
    "pause": (PauseCommand(), {"paused": True}),
    "resume": (ResumeCommand(), {"paused": False}),
    "tilt": (TiltCommand(-7.5), {"tilt_deg": -7.5}),
    "led": (LedCommand(Led.RED), {"led": "red"}),
    "start-recording": (StartRecordingCommand("desk"), FOLDER),
    "stop-recording": (StopRecordingCommand(), FOLDER),
    "save-map": (SaveMapCommand("kitchen"), {"file": "maps/kitchen.ply", "keyframes": 12}),
    "load-map": (LoadMapCommand("kitchen"), {"file": "maps/kitchen.keyframes"}),
    "save-incident": (SaveIncidentCommand(), FOLDER),
}


@pytest.fixture
def service() -> Iterator[FakeService]:
    """A service of each test's own, as a reply cannot be taken back."""
    with running_fake_service() as running:
        yield running


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_is_sent_and_its_reply_is_typed(
    service: FakeService, client: PoseClient, name: str
) -> None:
    command, reply = EXCHANGES[name]
    sent = set_reply(service, client, f"command/{name}", reply)
    assert client.send(command) == command.reply_type()(**reply)
    payload = b"" if sent[0] is None else json.dumps(sent[0]).encode()
    assert parse_command(name, payload) == command


def test_a_reset_without_a_pose_sends_none(service: FakeService, client: PoseClient) -> None:
    sent = set_reply(service, client, "command/reset", {"epoch": 1})
    assert client.send(ResetCommand()).epoch == 1
    assert sent == [None]


def test_a_refusal_has_the_message_and_code_of_the_service(
    service: FakeService, client: PoseClient
) -> None:
    refusal = {"error": "not-possible", "message": "it has no motor"}
    set_reply(service, client, "command/tilt", refusal)
    with pytest.raises(CommandRefused, match="it has no motor") as caught:
        client.send(TiltCommand(3.0))
    assert caught.value.code == "not-possible"


def test_a_command_without_a_service_raises_an_error(client: PoseClient) -> None:
    with pytest.raises(ServiceUnavailable, match="kinect/command/pause: no kinect-vo answers"):
        client.command("pause", timeout_s=0.2)


def test_a_reply_of_another_version_is_rejected(service: FakeService, client: PoseClient) -> None:
    set_reply(service, client, "schema", {"schema": 9, "schemas": {}})
    with pytest.raises(ValueError, match="version 9"):
        client.schemas()


def test_a_missing_status_is_queried(service: FakeService, client: PoseClient) -> None:
    set_reply(service, client, "status", {"state": "tracking", "reason": "", "paused": False})
    assert client.status()["state"] == "tracking"


def test_a_blocked_service_raises_the_same_error(service: FakeService, client: PoseClient) -> None:
    pending: list[zenoh.Query] = []
    service.session.declare_queryable("kinect/command/pause", pending.append)
    querier: Any = client._connection.sessions[0].declare_querier("kinect/command/pause")
    wait_until(lambda: bool(querier.matching_status.matching))
    with pytest.raises(
        ServiceUnavailable, match=r"kinect/command/pause: no reply within 0\.3 s: .* hangs"
    ):
        client.command("pause", timeout_s=0.3)


@pytest.mark.parametrize("reply", [{}, {"epoch": "4"}, {"epoch": True}])
def test_a_reply_of_another_structure_is_rejected(
    service: FakeService, client: PoseClient, reply: dict[str, Any]
) -> None:
    set_reply(service, client, "command/reset", reply)
    with pytest.raises(ValueError, match="the reply to command/reset came with"):
        client.send(ResetCommand())


def test_a_refusal_of_another_structure_is_reported(
    service: FakeService, client: PoseClient
) -> None:
    set_reply(service, client, "command/pause", {"error": 3, "message": "no"})
    with pytest.raises(
        ServiceUnavailable, match="cannot parse the reply: an error reply came with a int for error"
    ):
        client.send(PauseCommand())
