"""Command server on `{prefix}/command/NAME`: puts commands into the loop's queue and replies."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import zenoh

from drivers.core.flow_control import BlockingQueue, TokenBucket, WorkerThread
from vo_service.config_tables import CommandConfig
from vo_service.control import CommandFuture, CommandSink
from vo_service.outputs.zenoh.queryables import (
    MAX_PENDING_QUERIES,
    reply,
    reply_error,
    serve_queryable,
)
from vo_service.types.commands import (
    MAX_PAYLOAD_BYTES,
    Command,
    CommandError,
    ErrorCode,
    parse_command,
)
from vo_service.types.messages import encode_message

logger = logging.getLogger(__name__)


# The loop handles commands several times a second; after this long, it hangs.
RESULT_TIMEOUT_S = 5.0
LOG_PERIOD_S = 60.0
CLOSE_TIMEOUT_S = 0.5


class CommandEndpoint(Protocol):
    """Endpoint that receives commands."""

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Start to reply on a new session; return the threads."""
        ...

    def configure(self, settings: CommandConfig) -> None:
        """Set a new rate limit; `enabled` is ignored."""
        ...

    def close(self) -> None:
        """Stop replying."""
        ...


class NullCommandEndpoint:
    """Endpoint without commands."""

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Declare nothing."""
        return []

    def configure(self, settings: CommandConfig) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class _PendingCommand:
    """A command in the loop's queue, and the query that waits for its result."""

    query: zenoh.Query
    key: str
    future: CommandFuture[Any]


class CommandServer:
    """Server of all commands of `vo_service.types.commands`, with a rate limit.

    One queryable serves all names, so it can report an unknown command. One thread parses and
    refuses; another waits for the loop's results and sends the replies in order.
    """

    def __init__(self, command_queue: CommandSink[Command], per_second: float) -> None:
        self._command_queue = command_queue
        self._rate_limit = CommandRateLimit(per_second)
        self._replies: WorkerThread[_PendingCommand] = WorkerThread(
            "zenoh-answers", BlockingQueue(MAX_PENDING_QUERIES), _send_reply, lambda: None
        )

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Start to reply on a new session; return the thread."""
        key_prefix = f"{prefix}/command/"
        return [serve_queryable(session, f"{key_prefix}*", partial(self._receive, key_prefix))]

    def configure(self, settings: CommandConfig) -> None:
        """Set a new rate limit."""
        self._rate_limit = CommandRateLimit(settings.per_second)

    def close(self) -> None:
        """Stop replying; pending commands get no reply."""
        self._replies.close(CLOSE_TIMEOUT_S)

    def _receive(self, key_prefix: str, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:  # a wildcard query reads keys; it is not a command
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            self._rate_limit.check()
            command = parse_command(key.removeprefix(key_prefix), _read_payload(query))
            self._replies.put(_PendingCommand(query, key, self._command_queue.submit(command)))
        except CommandError as error:
            reply_error(query, error)


def _send_reply(pending: _PendingCommand) -> None:
    try:
        payload = encode_message(pending.future.result(RESULT_TIMEOUT_S))
    except CommandError as error:
        logger.info("zenoh: %s: %s", pending.key, error)
        reply_error(pending.query, error)
    except (TypeError, ValueError) as error:
        reply_error(
            pending.query, CommandError(ErrorCode.FAILED, f"its result is not JSON: {error}")
        )
    else:
        logger.info("zenoh: %s: done", pending.key)
        reply(pending.query, pending.key, payload)


def make_command_endpoint(
    settings: CommandConfig, command_queue: CommandSink[Command]
) -> CommandEndpoint:
    """Make the configured command endpoint."""
    return (
        CommandServer(command_queue, settings.per_second)
        if settings.enabled
        else NullCommandEndpoint()
    )


class CommandRateLimit:
    """Rate limit of commands, which logs refusals now and then. For one thread."""

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._bucket = TokenBucket(per_second, now_s)
        self._now_s = now_s
        self._rejected = 0
        self._logged_s = float("-inf")

    def check(self) -> None:
        """Count one command. Raises CommandError (rate-limited) above the limit."""
        if self._bucket.try_acquire():
            return
        self._rejected += 1
        limit = f"more than {self._bucket.per_second:g} commands a second"
        if self._now_s() - self._logged_s >= LOG_PERIOD_S:
            logger.warning("zenoh: %s: refused %d (logged once a minute)", limit, self._rejected)
            self._logged_s, self._rejected = self._now_s(), 0
        raise CommandError(ErrorCode.RATE_LIMITED, f"{limit}; wait, then try again")


def _read_payload(query: zenoh.Query) -> bytes:
    """Read the payload if it is small enough. Raises CommandError (bad-request)."""
    if not query.parameters.is_empty():
        raise CommandError(
            ErrorCode.BAD_REQUEST, "send arguments as JSON in the payload, not after a `?`"
        )
    payload = query.payload
    if payload is None:
        return b""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            f"the payload has {len(payload)} bytes; the limit is {MAX_PAYLOAD_BYTES}",
        )
    return payload.to_bytes()
