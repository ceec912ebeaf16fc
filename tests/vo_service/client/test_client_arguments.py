"""Invalid arguments raise a one-line error, and nothing is sent."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.vo_service.client.fake_service import find_free_endpoint
from vo_service import InputError, PoseClient, ServiceUnavailable
from vo_service.types.commands import PauseCommand, TiltCommand

pytestmark = pytest.mark.zenoh

NAN = math.nan
Call = Callable[[PoseClient], object]


@pytest.fixture(scope="module")
def lone_client() -> Iterator[PoseClient]:
    """A client without a service."""
    with PoseClient(connect=find_free_endpoint()) as client:
        yield client


@pytest.mark.parametrize(
    "call",
    [
        lambda client: client.newest(max_age_s=NAN),
        lambda client: client.newest(max_age_s=-0.1),
        lambda client: client.poses(timeout_s=NAN),
        lambda client: client.wait_for_publisher(-1.0),
        lambda client: client.query_latest(timeout_s=-1.0),
        lambda client: client.status(timeout_s=float("inf")),
        lambda client: client.send(TiltCommand(NAN)),
        lambda client: client.command("led", {"led": object()}),
        lambda client: client.send_wheel_odometry(1e12, 0.0, 0.0, 0.0),
        lambda client: client.send_wheel_odometry(1.0, 0.0, 0.0, 0.0, (NAN, 0.0, 0.0)),
    ],
)
def test_invalid_arguments_are_rejected_in_one_line_by_the_client(
    lone_client: PoseClient, call: Call
) -> None:
    with pytest.raises(InputError) as caught:
        call(lone_client)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wrong", [NAN, math.inf, "fast", None])
@pytest.mark.parametrize(
    ("send", "count"), [(PoseClient.send_wheel_odometry, 4), (PoseClient.send_velocity, 2)]
)
def test_an_argument_that_is_no_number_is_not_sent(
    lone_client: PoseClient, send: Callable[..., None], count: int, wrong: Any
) -> None:
    for place in range(count):
        arguments = [1.0] * count
        arguments[place] = wrong
        with pytest.raises(InputError, match="is not a finite number"):
            send(lone_client, *arguments)


def test_an_address_that_is_no_endpoint_is_named_as_the_parameter_that_it_is() -> None:
    with pytest.raises(InputError, match=r"^connect = 'robot:7450': an endpoint is written PROTO"):
        PoseClient(connect="robot:7450")


@pytest.mark.parametrize("name", ["", "reset#", "reset$", "a/b", "*", "reset\n", "réset", "a?b"])
def test_an_invalid_command_name_is_not_sent(lone_client: PoseClient, name: str) -> None:
    with pytest.raises(InputError, match="not a command name"):
        lone_client.command(name)


@pytest.mark.parametrize(
    "call",
    [
        PoseClient.query_latest,
        lambda client: client.send(PauseCommand()),
        PoseClient.schemas,
        lambda client: client.send_wheel_odometry(1.0, 0.0, 0.0, 0.0),
    ],
)
def test_a_closed_client_raises_an_error(call: Call) -> None:
    client = PoseClient(connect=find_free_endpoint())
    client.close()
    with pytest.raises(ServiceUnavailable, match="kinect: this client is closed; open another"):
        call(client)
