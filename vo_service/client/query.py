"""Asking a service over Zenoh: one question, one answer or an error that says why not."""

from collections.abc import Sequence

import zenoh

from vo_service.client.errors import CommandRefused, ServiceUnavailable
from vo_service.client.message_parsing import check_fields, parse_json

# What Zenoh itself answers where a service is there but says nothing, as when it hangs.
_ZENOH_TIMEOUT = b"Timeout"


def query(
    sessions: Sequence[zenoh.Session], key: str, timeout_s: float, payload: bytes | None = None
) -> zenoh.Sample:
    """The answer to a question; `sessions` is the one that is open, or none.

    Raises CommandRefused with what the service said, NoAnswer if nobody says anything in time.
    """
    for session in sessions:
        for reply in _send_query(session, key, timeout_s, payload):
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None and reply.err.payload.to_bytes() != _ZENOH_TIMEOUT:
                raise _error_from_reply(key, reply.err)
    raise ServiceUnavailable(
        f"{key}: no answer within {timeout_s:g} s: no service is there, it is flooded with "
        "questions or stuck, or it may not answer us"
    )


def _send_query(
    session: zenoh.Session, key: str, timeout_s: float, payload: bytes | None
) -> zenoh.Handler[zenoh.Reply]:
    try:
        return session.get(key, payload=payload, timeout=timeout_s)
    except zenoh.ZError as error:  # closed by another thread
        raise ServiceUnavailable(f"{key}: cannot be asked: {error}") from error


def _error_from_reply(key: str, error: zenoh.ReplyError) -> Exception:
    try:
        content = parse_json(error.payload)
        check_fields("a refusal", content, {"error": str, "message": str})
    except ValueError as unreadable:
        return ServiceUnavailable(f"{key}: the answer cannot be read: {unreadable}")
    return CommandRefused(content["error"], content["message"])
