"""Commands over real Zenoh: what reaches the inbox, what comes back, and what is refused."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
import zenoh

from drivers.sensor_config import Led
from tests import ports
from tests.vo_service.outputs.zenoh.query_helpers import (
    answer_next_command,
    config,
    connected_session,
    next_command,
    output_with_commands,
    query,
    query_json,
    reply_json,
)
from vo_service.command_parser import COMMAND_NAMES
from vo_service.command_queue import CommandQueue
from vo_service.config_tables import CommandConfig
from vo_service.outputs.zenoh import command_server
from vo_service.outputs.zenoh.command_server import (
    CommandServer,
    NullCommandEndpoint,
    make_command_endpoint,
)
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.types import (
    Command,
    CommandError,
    ErrorCode,
    LedCommand,
    OdometryUpdate,
    PauseCommand,
    ResetCommand,
)

pytestmark = pytest.mark.zenoh

MakeUpdate = Callable[..., OdometryUpdate]


@pytest.fixture(scope="module")
def desk() -> Iterator[tuple[CommandQueue[Command], zenoh.Session]]:
    """An inbox that takes commands without a limit, and a session to send them from."""
    with output_with_commands(ports.free_port()) as (_, inbox, session):
        yield inbox, session


Desk = tuple[CommandQueue[Command], zenoh.Session]


def test_a_command_reaches_the_inbox_and_its_answer_the_asker(desk: Desk) -> None:
    inbox, session = desk
    channel = session.get("kinect/command/led", payload=b'{"led": "red"}', timeout=100)
    ticket = next_command(inbox)
    ticket.set_result({"led": "red"})
    (reply,) = channel
    assert ticket.command == LedCommand(Led.RED)
    assert reply_json(reply) == {"schema": 1, "led": "red"}
    assert reply.ok is not None
    assert str(reply.ok.key_expr) == "kinect/command/led"


def test_no_payload_means_no_arguments(desk: Desk) -> None:
    inbox, session = desk
    channel = session.get("kinect/command/reset", timeout=100)
    ticket = next_command(inbox)
    ticket.set_result({"epoch": 3})
    assert [reply_json(reply) for reply in channel] == [{"schema": 1, "epoch": 3}]
    assert isinstance(ticket.command, ResetCommand)


def test_what_the_loop_refuses_comes_back_with_its_code(desk: Desk) -> None:
    inbox, session = desk
    channel = session.get("kinect/command/tilt", payload=b'{"tilt_deg": 5}', timeout=100)
    next_command(inbox).set_exception(
        CommandError(ErrorCode.NOT_POSSIBLE, "this camera has no motor")
    )
    (answer,) = map(reply_json, channel)
    assert answer == {"schema": 1, "error": "not-possible", "message": "this camera has no motor"}


@pytest.mark.parametrize(
    ("name", "payload", "code", "words"),
    [
        ("dance", b"", "unknown-command", "there is no command 'dance'; there are: reset"),
        ("tilt", b"", "bad-request", "argument 'tilt_deg' is missing"),
        ("tilt", b'{"tilt_deg": 90}', "bad-request", "from -31 to 31"),
        ("pause", b'{"now": true}', "bad-request", "not an argument of pause"),
        ("pause", b"\xff\xfe", "bad-request", "not JSON"),
        ("pause", b"[" * 4000, "bad-request", "not JSON"),
        ("pause", b" " * 4097, "bad-request", "4097 bytes are too many; the limit is 4096"),
        ("pause?now=true", b"", "bad-request", "arguments go into the payload"),
    ],
)
def test_what_is_wrong_is_said_and_never_reaches_the_loop(
    desk: Desk, name: str, payload: bytes, code: str, words: str
) -> None:
    inbox, session = desk
    (answer,) = query_json(session, f"kinect/command/{name}", payload)
    assert inbox.take_pending() == []
    assert (answer["schema"], answer["error"]) == (1, code)
    assert words in answer["message"]


def test_a_payload_beyond_all_bounds_is_thrown_away_and_the_next_command_works(
    desk: Desk,
) -> None:
    inbox, session = desk
    session.get("kinect/command/pause", payload=bytes(3_000_000), timeout=1)
    answer_next_command(inbox, {"paused": True})
    assert query_json(session, "kinect/command/pause") == [{"schema": 1, "paused": True}]


@pytest.mark.parametrize("key", ["kinect/**", "**", "kinect/command/*", "*/command/reset"])
def test_a_question_to_many_keys_commands_nothing(desk: Desk, key: str) -> None:
    inbox, session = desk
    assert not [reply for reply in query(session, key) if "command" in str(reply.ok)]
    assert inbox.take_pending() == []


def test_a_loop_that_does_not_answer_is_said_to_time_out(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_server, "RESULT_TIMEOUT_S", 0.05)
    inbox, session = desk
    (answer,) = query_json(session, "kinect/command/pause")
    assert answer["error"] == "timed-out"
    assert [ticket.command for ticket in inbox.take_pending()] == [PauseCommand()]


@pytest.mark.parametrize("answer", [{"speed": float("nan")}, {"what": object()}])
def test_an_answer_that_is_no_json_is_a_failure(desk: Desk, answer: dict[str, object]) -> None:
    inbox, session = desk
    answer_next_command(inbox, answer)
    assert query_json(session, "kinect/command/pause")[0]["error"] == "failed"


def test_switched_off_there_are_no_commands(free_port: int) -> None:
    commands = make_command_endpoint(CommandConfig(enabled=False), CommandQueue())
    assert isinstance(commands, NullCommandEndpoint)
    with closing(ZenohOutput(config(free_port))), connected_session(free_port) as session:
        assert query(session, "kinect/command/pause") == []


def test_every_command_is_answered(free_port: int) -> None:
    with output_with_commands(free_port) as (_, inbox, session):
        inbox.close()
        codes = {
            name: query_json(session, f"kinect/command/{name}")[0]["error"]
            for name in COMMAND_NAMES
        }
    assert set(codes.values()) <= {"not-possible", "bad-request"}


def test_closing_does_not_wait_for_a_command_that_the_loop_has(free_port: int) -> None:
    with output_with_commands(free_port) as (output, inbox, session):
        session.get("kinect/command/pause", timeout=100)
        ticket = next_command(inbox)
        before_s = time.monotonic()
        output.close()
        assert time.monotonic() - before_s < command_server.RESULT_TIMEOUT_S
        ticket.set_result({})
    assert isinstance(ticket.command, PauseCommand)


def test_a_second_session_takes_commands_too(free_port: int) -> None:
    inbox: CommandQueue[Command] = CommandQueue()
    commands = CommandServer(inbox, 100.0)
    for _ in range(2):
        with asking_itself(commands, free_port) as session:
            answer_next_command(inbox, {})
            assert query_json(session, "kinect/command/pause") == [{"schema": 1}]
    commands.close()


def asking_itself(commands: CommandServer, port: int) -> zenoh.Session:
    """A session that has the commands and can be asked for them."""
    session = open_session(config(port))
    commands.declare(session, "kinect")
    return session
