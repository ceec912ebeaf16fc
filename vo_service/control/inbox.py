"""How commands reach the loop, which takes them between two frames, and how its answers go back."""

import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, Generic, Protocol, TypeVar

from vo_service.types import CommandError, ErrorCode

MOST_WAITING = 8

Answer = Mapping[str, object]
C = TypeVar("C")
C_contra = TypeVar("C_contra", contravariant=True)


class Ticket(Generic[C]):
    """A command on its way: the loop answers it, whoever sent it waits for that."""

    def __init__(self, command: C) -> None:
        self.command = command
        self._is_answered = threading.Event()
        self._answer: Answer = {}
        self._error: CommandError | None = None

    def wait(self, timeout_s: float) -> Answer:
        """What the command gave. Raises CommandError: its own, or timed-out."""
        if not self._is_answered.wait(timeout_s):
            raise CommandError(
                ErrorCode.TIMED_OUT, f"no answer within {timeout_s:g} s; it may still be done"
            )
        if self._error is not None:
            raise self._error
        return self._answer

    def done(self, answer: Answer) -> None:
        """The command was carried out."""
        self._answer = answer
        self._is_answered.set()

    def failed(self, error: CommandError) -> None:
        """It was not."""
        self._error = error
        self._is_answered.set()


class TakesIn(Protocol[C_contra]):
    """What those see of an inbox who only hand in."""

    def submit(self, command: C_contra) -> Ticket[Any]:
        """See `Inbox`."""
        ...


class Inbox(Generic[C]):
    """A short queue: many may hand in, the loop takes."""

    def __init__(self, most: int = MOST_WAITING) -> None:
        self._most = most
        self._waiting: deque[Ticket[C]] = deque()
        self._lock = threading.Lock()
        self._is_closed = False

    def submit(self, command: C) -> Ticket[C]:
        """Hand in a command. Raises CommandError: busy, or not-possible as the service ends."""
        ticket = Ticket(command)
        with self._lock:
            if self._is_closed:
                raise CommandError(ErrorCode.NOT_POSSIBLE, "the service is ending")
            if len(self._waiting) >= self._most:
                raise CommandError(
                    ErrorCode.BUSY, f"{self._most} commands are waiting already; try again"
                )
            self._waiting.append(ticket)
        return ticket

    def order(self, command: C) -> Ticket[C]:
        """Hand in a command of the program's own, which is never refused for want of room."""
        ticket = Ticket(command)
        with self._lock:
            self._waiting.append(ticket)
        return ticket

    def take(self) -> list[Ticket[C]]:
        """All that wait, the oldest first; never waits itself."""
        if not self._waiting:
            return []
        with self._lock:
            tickets = list(self._waiting)
            self._waiting.clear()
        return tickets

    def close(self) -> None:
        """Refuse what waits and whatever comes."""
        with self._lock:
            self._is_closed = True
        for ticket in self.take():
            ticket.failed(CommandError(ErrorCode.NOT_POSSIBLE, "the service is ending"))
