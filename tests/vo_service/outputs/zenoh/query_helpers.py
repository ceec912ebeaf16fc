"""Queries to a Zenoh output in this process, as another program would send them."""

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from queue import SimpleQueue
from typing import Any

import zenoh
import zenoh.ext

from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.control import CommandFuture, CommandQueue
from vo_service.outputs.zenoh.output import LIVE_QOS, ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import CommandServer, ExtraEndpoints
from vo_service.types.odometry_update import OdometryUpdate


def config(port: int, **changes: Any) -> ZenohConfig:
    """Make a configuration that listens on this port of 127.0.0.1."""
    return ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",), **changes)


@contextmanager
def connected_session(port: int) -> Iterator[zenoh.Session]:
    """Open a session that is connected to this port."""
    with open_session(ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))) as session:
        wait_until(lambda: bool(session.info.links()))
        yield session


@contextmanager
def output_with_commands(
    port: int, per_second: float = 1000.0
) -> Iterator[tuple[ZenohOutput, CommandQueue, zenoh.Session]]:
    """Run an output with commands; yield it, its command queue and a session to send from."""
    command_queue = CommandQueue()
    extras = ExtraEndpoints(commands=CommandServer(command_queue, per_second))
    with (
        closing(ZenohOutput(config(port), LIVE_QOS, extra_endpoints=extras)) as output,
        connected_session(port) as session,
    ):
        wait_until(lambda: bool(query_json(session, "kinect/schema")))
        yield output, command_queue, session


def query(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[zenoh.Reply]:
    """Return all replies."""
    return list(session.get(key, payload=payload, timeout=DEFAULT_TIMEOUT_S))


def query_json(
    session: zenoh.Session, key: str, payload: bytes | None = None
) -> list[dict[str, Any]]:
    """Return the JSON of all replies, also of errors."""
    return [reply_json(reply) for reply in query(session, key, payload)]


def reply_json(reply: zenoh.Reply) -> dict[str, Any]:
    """Return the JSON of one reply, also of an error."""
    payload = reply.ok.payload if reply.ok else reply_error(reply).payload
    content: dict[str, Any] = json.loads(payload.to_bytes())
    return content


def reply_error(reply: zenoh.Reply) -> zenoh.ReplyError:
    """Return the error of a reply."""
    assert reply.err is not None
    return reply.err


def attachment_of(sample: zenoh.Sample) -> dict[str, Any]:
    """Return the attachment."""
    assert sample.attachment is not None
    found: dict[str, Any] = json.loads(sample.attachment.to_bytes())
    return found


def queried_seq(session: zenoh.Session, key: str) -> int:
    """Return the number of the pose in the reply to a query; -1 for an error reply."""
    (reply,) = query(session, key)
    return int(attachment_of(reply.ok)["seq"]) if reply.ok else -1


def late_sample(session: zenoh.Session, key: str) -> bytes:
    """Return the payload that was published before this subscription."""
    received: SimpleQueue[zenoh.Sample] = SimpleQueue()
    with zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        received.put,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    ):
        return received.get(timeout=DEFAULT_TIMEOUT_S).payload.to_bytes()


class PoseSubscriber:
    """A subscriber to an output's poses, in this process."""

    def __init__(self, session: zenoh.Session, output: ZenohOutput) -> None:
        self._output = output
        self._received: SimpleQueue[zenoh.Sample] = SimpleQueue()
        session.declare_subscriber("kinect/odom", self._received.put)
        assert output.wait_for_subscriber(20)

    def receives_all(self, updates: list[OdometryUpdate]) -> bool:
        """Publish; return whether each pose is received before the next one is published."""
        for update in updates:
            self._output.on_update(update)
            if attachment_of(self._received.get(timeout=100))["seq"] != update.seq:
                return False
        return (self._output.dropped, self._output.errors) == (0, 0)


def next_command(command_queue: CommandQueue) -> CommandFuture:
    """Wait for the next command."""
    pending: list[CommandFuture] = []

    def has_arrived() -> bool:
        pending.extend(command_queue.take_pending())
        return bool(pending)

    wait_until(has_arrived)
    return pending[0]


def answer_next_command(command_queue: CommandQueue, reply: object) -> None:
    """Complete the next command, on a thread, as the loop would."""
    threading.Thread(
        target=lambda: next_command(command_queue).set_result(reply), daemon=True
    ).start()
