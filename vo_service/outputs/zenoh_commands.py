"""Commands over Zenoh: `{prefix}/command/NAME`, into the loop's inbox and back."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import zenoh

from vo_service.control.commands import LARGEST_PAYLOAD_BYTES, parse_command
from vo_service.control.inbox import TakesIn, Ticket
from vo_service.outputs.worker import Wait, Worker
from vo_service.outputs.zenoh_messages import answer_payload
from vo_service.outputs.zenoh_questions import MOST_WAITING, answer_questions, refuse, reply
from vo_service.settings import CommandSettings
from vo_service.token_bucket import TokenBucket
from vo_service.types import Command, CommandError, ErrorCode

logger = logging.getLogger(__name__)

# The loop comes round several times a second; longer than this it does not think about a command.
ANSWER_LIMIT_S = 5.0
LOG_PERIOD_S = 60.0
CLOSE_S = 0.5


class Commands(Protocol):
    """What operators may ask."""

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Begin to answer on a session that has just been opened; the threads that do."""
        ...

    def configure(self, settings: CommandSettings) -> None:
        """Take a new limit; whether there are commands at all stays as it is."""
        ...

    def close(self) -> None:
        """Answer no more."""
        ...


class NoCommands:
    """Nothing."""

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Declare nothing."""
        return []

    def configure(self, settings: CommandSettings) -> None:
        """No limit is needed."""

    def close(self) -> None:
        """Nothing to end."""


@dataclass(frozen=True)
class _Asked:
    """A command that the loop has, and who waits for the answer."""

    query: zenoh.Query
    key: str
    ticket: Ticket[Any]


class CommandsFor:
    """Every command of `vo_service.control.commands`, so many a second, into an inbox.

    One queryable for all names: it can say that there is no such command. One thread reads and
    refuses, another waits for the loop's answers and gives them out, in order.
    """

    def __init__(self, inbox: TakesIn[Command], per_second: float) -> None:
        self._inbox = inbox
        self._limit = RateLimit(per_second)
        self._answers: Worker[_Asked] = Worker(
            "zenoh-answers", Wait(MOST_WAITING), _give_out, lambda: None
        )

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """See `Commands`."""
        folder = f"{prefix}/command/"
        return [answer_questions(session, f"{folder}*", partial(self._take_in, folder))]

    def configure(self, settings: CommandSettings) -> None:
        """See `Commands`."""
        self._limit = RateLimit(settings.per_second)

    def close(self) -> None:
        """See `Commands`; what the loop has not answered by now it will not."""
        self._answers.close(CLOSE_S)

    def _take_in(self, folder: str, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:  # who asks for all there is to read means no command
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            self._limit.check()
            command = parse_command(key.removeprefix(folder), _arguments(query))
            self._answers.put(_Asked(query, key, self._inbox.submit(command)))
        except CommandError as error:
            refuse(query, error)


def _give_out(asked: _Asked) -> None:
    try:
        payload = answer_payload(asked.ticket.wait(ANSWER_LIMIT_S))
    except CommandError as error:
        logger.info("zenoh: %s: %s", asked.key, error)
        refuse(asked.query, error)
    except (TypeError, ValueError) as error:
        refuse(asked.query, CommandError(ErrorCode.FAILED, f"its answer is no JSON: {error}"))
    else:
        logger.info("zenoh: %s: done", asked.key)
        reply(asked.query, asked.key, payload)


def commands_for(settings: CommandSettings, inbox: TakesIn[Command]) -> Commands:
    """What the settings ask for."""
    return CommandsFor(inbox, settings.per_second) if settings.enabled else NoCommands()


class RateLimit:
    """Refuses commands beyond so many a second, and logs that now and then. For one thread."""

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._bucket = TokenBucket(per_second, now_s)
        self._now_s = now_s
        self._refused = 0
        self._logged_s = float("-inf")

    def check(self) -> None:
        """Raises CommandError: rate-limited."""
        if self._bucket.take():
            return
        self._refused += 1
        limit = f"more than {self._bucket.per_second:g} commands a second"
        if self._now_s() - self._logged_s >= LOG_PERIOD_S:
            logger.warning("zenoh: %s: refused %d (told once a minute)", limit, self._refused)
            self._logged_s, self._refused = self._now_s(), 0
        raise CommandError(ErrorCode.RATE_LIMITED, f"{limit}; wait, then try again")


def _arguments(query: zenoh.Query) -> bytes:
    """The payload, looked at only if it is small enough. Raises CommandError: bad-request."""
    if not query.parameters.is_empty():
        raise CommandError(
            ErrorCode.BAD_REQUEST, "arguments go into the payload, as JSON, not behind a `?`"
        )
    payload = query.payload
    if payload is None:
        return b""
    if len(payload) > LARGEST_PAYLOAD_BYTES:
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            f"{len(payload)} bytes are too many; the limit is {LARGEST_PAYLOAD_BYTES}",
        )
    return payload.to_bytes()
