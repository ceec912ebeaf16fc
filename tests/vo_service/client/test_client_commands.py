"""What a client sends for each of its methods, and what becomes of the answers."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from drivers.core.geometry import rigid_transform
from tests.vo_service.client.fake_service import (
    FakeService,
    find_free_endpoint,
    running_fake_service,
)
from tests.waiting import wait_until
from vo_service.client import CommandRefused, PoseClient, ServiceUnavailable
from vo_service.command_parser import COMMAND_NAMES, parse_command

pytestmark = pytest.mark.zenoh

Talk = tuple[FakeService, PoseClient]
FOLDER = {"folder": "/var/lib/kinect-vo/desk"}
T_ODOM_BASE = rigid_transform(np.eye(3), [1.0, 2.0, 0.5])
CALLS: dict[str, tuple[Callable[[PoseClient], object], dict[str, Any], object]] = {
    "reset": (lambda client: client.reset(T_ODOM_BASE), {"epoch": 4}, 4),
    "pause": (PoseClient.pause, {"paused": True}, None),
    "resume": (PoseClient.resume, {"paused": False}, None),
    "tilt": (lambda client: client.tilt(-7.5), {"tilt_deg": -7.5}, None),
    "led": (lambda client: client.led("red"), {"led": "red"}, None),
    "start-recording": (lambda client: client.start_recording("desk"), FOLDER, FOLDER["folder"]),
    "stop-recording": (PoseClient.stop_recording, FOLDER, FOLDER["folder"]),
    "save-map": (
        lambda client: client.save_map("kitchen"),
        {"file": "/var/lib/kinect-vo/maps/kitchen.ply", "keyframes": 12},
        "/var/lib/kinect-vo/maps/kitchen.ply",
    ),
    "load-map": (
        lambda client: client.load_map("kitchen"),
        {"file": "/var/lib/kinect-vo/maps/kitchen.places"},
        "/var/lib/kinect-vo/maps/kitchen.places",
    ),
    "save-incident": (PoseClient.save_incident, FOLDER, FOLDER["folder"]),
}


@pytest.fixture(scope="module")
def talk() -> Iterator[Talk]:
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as publisher, PoseClient(connect=endpoint) as client:
        assert client.wait_for_publisher(20)
        yield publisher, client


@pytest.fixture
def lone() -> Iterator[Talk]:
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as publisher, PoseClient(connect=endpoint) as client:
        yield publisher, client


def answering(talk: Talk, name: str, answer: dict[str, Any]) -> list[Any]:
    """Let the service answer in this way; what was asked, once it is."""
    publisher, client = talk
    asked = publisher.answer_with(name, answer)
    querier: Any = client._connection.sessions[0].declare_querier(f"kinect/{name}")
    wait_until(lambda: bool(querier.matching_status.matching))
    return asked


def test_there_is_a_method_for_every_command() -> None:
    assert CALLS.keys() == set(COMMAND_NAMES)


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_a_method_sends_what_the_service_takes_and_gives_back_its_answer(
    talk: Talk, name: str
) -> None:
    _, client = talk
    call, answer, given = CALLS[name]
    sent = answering(talk, f"command/{name}", answer)
    assert call(client) == given
    payload = b"" if sent[0] is None else json.dumps(sent[0]).encode()
    parse_command(name, payload)


def test_a_reset_without_a_pose_sends_none(lone: Talk) -> None:
    _, client = lone
    sent = answering(lone, "command/reset", {"epoch": 1})
    assert client.reset() == 1
    assert sent == [None]


def test_a_refusal_has_the_services_words_and_code(lone: Talk) -> None:
    _, client = lone
    answering(lone, "command/tilt", {"error": "not-possible", "message": "it has no motor"})
    with pytest.raises(CommandRefused, match="it has no motor") as caught:
        client.tilt(3.0)
    assert caught.value.code == "not-possible"


def test_a_command_that_nobody_takes_is_no_answer(lone: Talk) -> None:
    _, client = lone
    with pytest.raises(ServiceUnavailable, match="kinect/command/pause: no answer"):
        client.command("pause", timeout_s=0.2)


def test_an_answer_of_another_version_is_not_read(lone: Talk) -> None:
    _, client = lone
    answering(lone, "schema", {"schema": 9, "schemas": {}})
    with pytest.raises(ValueError, match="version 9"):
        client.schemas()


def test_a_status_that_was_not_heard_is_asked_for(lone: Talk) -> None:
    _, client = lone
    answering(lone, "status", {"state": "tracking", "reason": "", "paused": False})
    assert client.status()["state"] == "tracking"


def test_a_service_that_is_stuck_is_no_answer_in_the_same_words(lone: Talk) -> None:
    publisher, client = lone
    kept: list[zenoh.Query] = []
    publisher.session.declare_queryable("kinect/command/pause", kept.append)
    querier: Any = client._connection.sessions[0].declare_querier("kinect/command/pause")
    wait_until(lambda: bool(querier.matching_status.matching))
    with pytest.raises(
        ServiceUnavailable, match=r"kinect/command/pause: no answer within 0\.3 s: .* stuck"
    ):
        client.command("pause", timeout_s=0.3)


@pytest.mark.parametrize("answer", [{}, {"epoch": "4"}, {"epoch": True}])
def test_an_answer_of_another_shape_is_not_read(lone: Talk, answer: dict[str, Any]) -> None:
    _, client = lone
    answering(lone, "command/reset", answer)
    with pytest.raises(ValueError, match="the answer to command/reset came with"):
        client.reset()


def test_a_refusal_of_another_shape_is_told(lone: Talk) -> None:
    _, client = lone
    answering(lone, "command/pause", {"error": 3, "message": "no"})
    with pytest.raises(
        ServiceUnavailable, match="cannot be read: a refusal came with a int for error"
    ):
        client.pause()
