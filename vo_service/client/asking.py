"""Asking a service over Zenoh: one question, one answer or an error that says why not."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from vo_service.client.errors import CommandRefused, NoAnswer
from vo_service.client.pose import read_json


def ask(
    sessions: Sequence[zenoh.Session], key: str, timeout_s: float, payload: bytes | None = None
) -> zenoh.Sample:
    """The answer to a question; `sessions` is the one that is open, or none.

    Raises CommandRefused with what the service said, NoAnswer if nobody says anything in time.
    """
    for session in sessions:
        for reply in session.get(key, payload=payload, timeout=timeout_s):
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None:
                raise _refusal(reply.err)
    raise NoAnswer(
        f"{key}: no answer within {timeout_s:g} s: no service is there, it is flooded with "
        "questions, or it may not answer us"
    )


def ask_json(
    sessions: Sequence[zenoh.Session], key: str, timeout_s: float, arguments: Mapping[str, object]
) -> Mapping[str, Any]:
    """The answer to a question, both in JSON. Raises as `ask`, and ValueError."""
    payload = json.dumps(arguments).encode() if arguments else None
    return read_json(ask(sessions, key, timeout_s, payload).payload)


def _refusal(error: zenoh.ReplyError) -> Exception:
    try:
        content = read_json(error.payload)
        return CommandRefused(content["error"], content["message"])
    except (ValueError, KeyError):  # Zenoh itself says that time is up
        return NoAnswer(error.payload.to_bytes().decode(errors="replace"))
