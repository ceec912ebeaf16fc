"""Connection to a service: a session that opens in the background, queries and their errors."""

import json
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum

import zenoh

from drivers.core import InputError, UserFacingError
from vo_service.client.pose import Pose
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import ZenohUnavailableError, open_session
from vo_service.outputs.zenoh.zenoh_config import MAX_MESSAGE_BYTES
from vo_service.types.messages import ErrorReply, decode_message, parse_json_message

logger = logging.getLogger(__name__)


def check_timeout(timeout_s: float | None) -> None:
    """Raise InputError unless the timeout is None or a time that a thread can wait."""
    if timeout_s is not None and not 0 <= timeout_s <= threading.TIMEOUT_MAX:
        raise InputError(f"timeout_s = {timeout_s:g}: give seconds, zero or more and finite")


def encode_arguments(key: str, arguments: Mapping[str, object]) -> bytes | None:
    """Encode arguments as JSON; None if there are none.

    Raises:
        InputError: If they are not valid.
    """
    if not arguments:
        return None
    try:
        return json.dumps(dict(arguments), allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{key}: the arguments cannot be sent as JSON: {error}") from error


class PoseUnavailableReason(StrEnum):
    """Reason why there is no usable pose."""

    NO_PUBLISHER = "no-publisher"  # no kinect-vo with this prefix is reachable
    NO_CAMERA = "no-camera"
    LOST = "lost"  # the service repeats the last good pose
    PAUSED = "paused"
    SILENT = "silent"  # the service is up but publishes nothing: it hangs, or the network does
    UNREADABLE = "unreadable"  # another version of the messages


class PoseUnavailable(Exception):  # noqa: N818 (not necessarily an error)
    """There is no usable pose; the text says why.

    Attributes:
        reason: The same for programs.
        last: Last pose received, however old; None before the first.
    """

    def __init__(self, reason: PoseUnavailableReason, message: str, last: Pose | None) -> None:
        super().__init__(message)
        self.reason = reason
        self.last = last


class CommandRefused(Exception):  # noqa: N818 (named after what happened)
    """The service refused or failed a command; the text is the service's message.

    Attributes:
        code: bad-request, unknown-command, not-possible, busy, rate-limited, failed or timed-out.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class ServiceUnavailable(Exception):  # noqa: N818
    """No reply: no service is reachable, its commands are off, or access is denied.

    A closed client raises it for every query.
    """


class FrameUnavailable(Exception):  # noqa: N818
    """No image or points arrived in time; the text says why."""


RETRY_S = 1.0


class BackgroundConnection:
    """Session that is opened at once or, if no router answers, retried in the background.

    A Zenoh peer can open alone and find others later. A Zenoh client, as used with TLS, opens only
    while its router or service is reachable.
    """

    def __init__(
        self,
        config: ZenohConfig,
        on_open: Callable[[zenoh.Session], None],
        max_message_bytes: int = MAX_MESSAGE_BYTES,
    ) -> None:
        """Open the session.

        Args:
            config: Endpoints, or the configuration file that holds them.
            on_open: Called once, with the open session.
            max_message_bytes: Larger messages that come in are discarded.

        Raises:
            InputError: The configuration is invalid, so that retrying cannot help.
        """
        self._config = config
        self._on_open = on_open
        self._max_message_bytes = max_message_bytes
        self._closed = threading.Event()
        self._sessions: list[zenoh.Session] = []
        self._thread = threading.Thread(
            target=self._retry_until_open, name="connecting", daemon=True
        )
        try:
            self._open()
        except ZenohUnavailableError:
            self._thread.start()

    @property
    def sessions(self) -> list[zenoh.Session]:
        """The open session; empty before it opens."""
        return self._sessions

    def close(self) -> None:
        """Close the session or stop retrying; a retry under way may take two seconds."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        for session in self._sessions:
            session.close()  # type: ignore[no-untyped-call]

    def _retry_until_open(self) -> None:
        """Retry after every error, even for files: a key may be being replaced."""
        last_error = ""
        while not self._sessions and not self._closed.wait(RETRY_S):
            try:
                self._open()
            except ZenohUnavailableError:
                last_error = ""
            except UserFacingError as error:
                if str(error) != last_error:
                    logger.warning("%s; trying again", error)
                last_error = str(error)

    def _open(self) -> None:
        session = open_session(self._config, self._max_message_bytes)
        self._on_open(session)
        self._sessions = [session]


# Zenoh's own reply if a service has declared the key but does not reply, as when it hangs.
_ZENOH_TIMEOUT = b"Timeout"


def query(
    sessions: Sequence[zenoh.Session], key: str, timeout_s: float, payload: bytes | None = None
) -> zenoh.Sample:
    """Send a query and return the reply.

    Args:
        sessions: The open session; empty if there is none.
        timeout_s: Seconds to wait for the reply.
        payload: Arguments as JSON.

    Raises:
        CommandRefused: With the service's message.
        ServiceUnavailable: No reply came in time, or it cannot be parsed.
    """
    begin_s = time.monotonic()
    for session in sessions:
        for reply in _send_query(session, key, timeout_s, payload):
            if reply.ok is not None:
                return reply.ok
            if reply.err is not None and reply.err.payload.to_bytes() != _ZENOH_TIMEOUT:
                raise _error_from_reply(key, reply.err)
    if time.monotonic() - begin_s < 0.9 * timeout_s:
        raise ServiceUnavailable(
            f"{key}: no kinect-vo answers: none is running, or access is denied"
        )
    raise ServiceUnavailable(
        f"{key}: no reply within {timeout_s:g} s: the service is overloaded or hangs, or access is "
        "denied"
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
