"""Query of a service over Zenoh: one reply, or an error with the reason."""

from collections.abc import Sequence

import zenoh

from vo_service.client.errors import CommandRefused, ServiceUnavailable
from vo_service.types import ErrorReply, decode_message, parse_json_message

# Zenoh's own reply if a service has declared the key but does not reply, as when it hangs.
_ZENOH_TIMEOUT = b"Timeout"


def query(
    sessions: Sequence[zenoh.Session], key: str, timeout_s: float, payload: bytes | None = None
) -> zenoh.Sample:
    """Send a query and return the reply.

    Args:
        sessions: The open session; empty if there is none.
        key: Zenoh key.
        timeout_s: Seconds to wait for the reply.
        payload: Arguments as JSON.

    Raises:
        CommandRefused: With the service's message.
        ServiceUnavailable: No reply came in time, or it cannot be parsed.
    """
    for session in sessions:
        for reply in _send_query(session, key, timeout_s, payload):
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None and reply.err.payload.to_bytes() != _ZENOH_TIMEOUT:
                raise _error_from_reply(key, reply.err)
    raise ServiceUnavailable(
        f"{key}: no reply within {timeout_s:g} s: no service is running, it is overloaded or "
        "hangs, or access is denied"
    )


def _send_query(
    session: zenoh.Session, key: str, timeout_s: float, payload: bytes | None
) -> zenoh.Handler[zenoh.Reply]:
    try:
        return session.get(key, payload=payload, timeout=timeout_s)
    except zenoh.ZError as error:  # closed by another thread
        raise ServiceUnavailable(f"{key}: cannot send the query: {error}") from error


def _error_from_reply(key: str, error: zenoh.ReplyError) -> Exception:
    try:
        content = parse_json_message(error.payload.to_bytes())
        reply = decode_message(ErrorReply, content, "an error reply")
    except ValueError as unreadable:
        return ServiceUnavailable(f"{key}: cannot parse the reply: {unreadable}")
    return CommandRefused(reply.error, reply.message)
