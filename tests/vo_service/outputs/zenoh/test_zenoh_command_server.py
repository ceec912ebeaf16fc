"""Commands over real Zenoh: what reaches the queue, what is replied and what is refused."""

import time
from collections.abc import Iterator
from contextlib import closing

import pytest
import zenoh

from drivers.camera import Led
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
from vo_service.config_tables import CommandConfig
from vo_service.control import CommandQueue
from vo_service.outputs.zenoh import session_endpoints
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import (
    CommandServer,
    NullCommandEndpoint,
    make_command_endpoint,
)
from vo_service.types.commands import (
    COMMANDS,
    CommandError,
    ErrorCode,
    FolderReply,
    LedCommand,
    LedReply,
    PauseCommand,
    PausedReply,
    TiltReply,
)

pytestmark = pytest.mark.zenoh


@pytest.fixture(scope="module")
def queue_and_session() -> Iterator[tuple[CommandQueue, zenoh.Session]]:
    """A command queue without a rate limit, and a session to send from."""
    with output_with_commands(ports.free_port()) as (_, command_queue, session):
        yield command_queue, session


QueueAndSession = tuple[CommandQueue, zenoh.Session]


def test_a_command_reaches_the_queue_and_its_reply_the_client(
    queue_and_session: QueueAndSession,
) -> None:
    command_queue, session = queue_and_session
    channel = session.get("kinect/command/led", payload=b'{"led": "red"}', timeout=100)
    future = next_command(command_queue)
    future.set_result(LedReply(Led.RED))
    (reply,) = channel
    assert future.command == LedCommand(Led.RED)
    assert reply_json(reply) == {"schema": 1, "led": "red"}
    assert reply.ok is not None
    assert str(reply.ok.key_expr) == "kinect/command/led"


def test_a_refusal_of_the_loop_is_returned_with_its_code(
    queue_and_session: QueueAndSession,
) -> None:
    command_queue, session = queue_and_session
    channel = session.get("kinect/command/tilt", payload=b'{"tilt_deg": 5}', timeout=100)
    next_command(command_queue).set_exception(
        CommandError(ErrorCode.NOT_POSSIBLE, "this camera has no motor")
    )
    (reply_content,) = map(reply_json, channel)
    assert reply_content == {
        "schema": 1,
        "error": "not-possible",
        "message": "this camera has no motor",
    }


@pytest.mark.parametrize(
    ("name", "payload", "code", "message"),
    [
        ("dance", b"", "unknown-command", "there is no command 'dance'; there are: reset"),
        ("tilt", b"", "bad-request", "argument `tilt_deg` is missing"),
        ("pause", b"\xff\xfe", "bad-request", "not JSON"),
        ("pause", b" " * 4097, "bad-request", "the payload has 4097 bytes; the limit is 4096"),
        ("pause?now=true", b"", "bad-request", "send arguments as JSON in the payload"),
    ],
)
def test_wrong_arguments_are_reported_and_never_reach_the_loop(
    queue_and_session: QueueAndSession, name: str, payload: bytes, code: str, message: str
) -> None:
    command_queue, session = queue_and_session
    (reply_content,) = query_json(session, f"kinect/command/{name}", payload)
    assert command_queue.take_pending() == []
    assert (reply_content["schema"], reply_content["error"]) == (1, code)
    assert message in reply_content["message"]


def test_an_oversize_payload_is_discarded_and_the_next_command_works(
    queue_and_session: QueueAndSession,
) -> None:
    command_queue, session = queue_and_session
    session.get("kinect/command/pause", payload=bytes(3_000_000), timeout=1)
    answer_next_command(command_queue, PausedReply(True))
    assert query_json(session, "kinect/command/pause") == [{"schema": 1, "paused": True}]


@pytest.mark.parametrize("key", ["kinect/**", "**", "kinect/command/*", "*/command/reset"])
def test_a_wildcard_query_executes_nothing(queue_and_session: QueueAndSession, key: str) -> None:
    command_queue, session = queue_and_session
    assert not [reply for reply in query(session, key) if "command" in str(reply.ok)]
    assert command_queue.take_pending() == []


def test_a_blocked_loop_gives_a_timeout_error(
    queue_and_session: QueueAndSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_endpoints, "RESULT_TIMEOUT_S", 0.05)
    command_queue, session = queue_and_session
    (reply_content,) = query_json(session, "kinect/command/pause")
    assert reply_content["error"] == "timed-out"
    assert [future.command for future in command_queue.take_pending()] == [PauseCommand()]


@pytest.mark.parametrize("reply_content", [TiltReply(float("nan")), FolderReply(object())])  # type: ignore[arg-type]
def test_a_reply_that_is_not_json_is_a_failure(
    queue_and_session: QueueAndSession, reply_content: object
) -> None:
    command_queue, session = queue_and_session
    answer_next_command(command_queue, reply_content)
    assert query_json(session, "kinect/command/pause")[0]["error"] == "failed"


def test_disabled_commands_get_no_reply(free_port: int) -> None:
    commands = make_command_endpoint(CommandConfig(enabled=False), CommandQueue())
    assert isinstance(commands, NullCommandEndpoint)
    with closing(ZenohOutput(config(free_port))), connected_session(free_port) as session:
        assert query(session, "kinect/command/pause") == []


def test_every_command_gets_a_reply(free_port: int) -> None:
    with output_with_commands(free_port) as (_, command_queue, session):
        command_queue.close()
        codes = {
            name: query_json(session, f"kinect/command/{name}")[0]["error"] for name in COMMANDS
        }
    assert set(codes.values()) <= {"not-possible", "bad-request"}


def test_closing_does_not_wait_for_a_command_in_the_loop(free_port: int) -> None:
    with output_with_commands(free_port) as (output, command_queue, session):
        session.get("kinect/command/pause", timeout=100)
        future = next_command(command_queue)
        before_s = time.monotonic()
        output.close()
        assert time.monotonic() - before_s < session_endpoints.RESULT_TIMEOUT_S
        future.set_result(PausedReply(True))
    assert isinstance(future.command, PauseCommand)


def test_a_second_session_serves_commands_too(free_port: int) -> None:
    command_queue = CommandQueue()
    commands = CommandServer(command_queue, 100.0)
    for _ in range(2):
        with session_with_commands(commands, free_port) as session:
            answer_next_command(command_queue, PausedReply(True))
            assert query_json(session, "kinect/command/pause") == [{"schema": 1, "paused": True}]
    commands.close()


def session_with_commands(commands: CommandServer, port: int) -> zenoh.Session:
    """Open a session that serves the commands and can query them."""
    session = open_session(config(port))
    commands.declare(session, "kinect")
    return session
