"""Asking a Zenoh output in this process, as a program elsewhere would."""

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import zenoh

from tests.waiting import PATIENCE_S, wait_until
from vo_service.control.inbox import Inbox, Ticket
from vo_service.outputs.zenoh_commands import CommandsFor
from vo_service.outputs.zenoh_output import LIVE, Extras, ZenohOutput
from vo_service.outputs.zenoh_session import open_session
from vo_service.settings import ZenohConfig
from vo_service.types import Command


def config(port: int, **changes: Any) -> ZenohConfig:
    """Listens on this port of 127.0.0.1."""
    return ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",), **changes)


@contextmanager
def asking(port: int) -> Iterator[zenoh.Session]:
    """A session connected to that port."""
    with open_session(ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))) as session:
        wait_until(lambda: bool(session.info.links()))
        yield session


@contextmanager
def commanded(
    port: int, per_second: float = 1000.0
) -> Iterator[tuple[ZenohOutput, Inbox[Command], zenoh.Session]]:
    """An output that takes commands, its inbox, and a session to send them from."""
    inbox: Inbox[Command] = Inbox()
    extras = Extras(commands=CommandsFor(inbox, per_second))
    with (
        closing(ZenohOutput(config(port), LIVE, extras=extras)) as output,
        asking(port) as session,
    ):
        wait_until(lambda: bool(answers(session, "kinect/schema")))
        yield output, inbox, session


def ask(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[zenoh.Reply]:
    """All replies."""
    return list(session.get(key, payload=payload, timeout=PATIENCE_S))


def answers(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[dict[str, Any]]:
    """The JSON of all replies, good or bad."""
    return [content(reply) for reply in ask(session, key, payload)]


def content(reply: zenoh.Reply) -> dict[str, Any]:
    """The JSON of one reply, good or bad."""
    payload = reply.ok.payload if reply.ok else error_of(reply).payload
    found: dict[str, Any] = json.loads(payload.to_bytes())
    return found


def error_of(reply: zenoh.Reply) -> zenoh.ReplyError:
    """The error that a reply is."""
    assert reply.err is not None
    return reply.err


def taken(inbox: Inbox[Command]) -> Ticket[Command]:
    """The next command that comes."""
    found: list[Ticket[Command]] = []

    def is_there() -> bool:
        found.extend(inbox.take())
        return bool(found)

    wait_until(is_there)
    return found[0]


def obey(inbox: Inbox[Command], answer: dict[str, object]) -> None:
    """Answer the next command, on a thread, as the loop would."""
    threading.Thread(target=lambda: taken(inbox).done(answer), daemon=True).start()
