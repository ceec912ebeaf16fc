"""Asking a Zenoh output in this process, as a program elsewhere would."""

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import zenoh

from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service.command_queue import CommandFuture, CommandQueue
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.command_server import CommandServer
from vo_service.outputs.zenoh.output import LIVE_QOS, ExtraEndpoints, ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.types import Command


def config(port: int, **changes: Any) -> ZenohConfig:
    """Listens on this port of 127.0.0.1."""
    return ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",), **changes)


@contextmanager
def connected_session(port: int) -> Iterator[zenoh.Session]:
    """A session connected to that port."""
    with open_session(ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))) as session:
        wait_until(lambda: bool(session.info.links()))
        yield session


@contextmanager
def output_with_commands(
    port: int, per_second: float = 1000.0
) -> Iterator[tuple[ZenohOutput, CommandQueue[Command], zenoh.Session]]:
    """An output that takes commands, its inbox, and a session to send them from."""
    inbox: CommandQueue[Command] = CommandQueue()
    extras = ExtraEndpoints(commands=CommandServer(inbox, per_second))
    with (
        closing(ZenohOutput(config(port), LIVE_QOS, extra_endpoints=extras)) as output,
        connected_session(port) as session,
    ):
        wait_until(lambda: bool(query_json(session, "kinect/schema")))
        yield output, inbox, session


def query(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[zenoh.Reply]:
    """All replies."""
    return list(session.get(key, payload=payload, timeout=DEFAULT_TIMEOUT_S))


def query_json(
    session: zenoh.Session, key: str, payload: bytes | None = None
) -> list[dict[str, Any]]:
    """The JSON of all replies, good or bad."""
    return [reply_json(reply) for reply in query(session, key, payload)]


def reply_json(reply: zenoh.Reply) -> dict[str, Any]:
    """The JSON of one reply, good or bad."""
    payload = reply.ok.payload if reply.ok else reply_error(reply).payload
    found: dict[str, Any] = json.loads(payload.to_bytes())
    return found


def reply_error(reply: zenoh.Reply) -> zenoh.ReplyError:
    """The error that a reply is."""
    assert reply.err is not None
    return reply.err


def next_command(inbox: CommandQueue[Command]) -> CommandFuture[Command]:
    """The next command that comes."""
    found: list[CommandFuture[Command]] = []

    def is_there() -> bool:
        found.extend(inbox.take_pending())
        return bool(found)

    wait_until(is_there)
    return found[0]


def answer_next_command(inbox: CommandQueue[Command], answer: dict[str, object]) -> None:
    """Answer the next command, on a thread, as the loop would."""
    threading.Thread(target=lambda: next_command(inbox).set_result(answer), daemon=True).start()
