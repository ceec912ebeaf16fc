"""Whether a Rerun viewer is there, and still the same: spoken to in HTTP/2, as gRPC does.

A connection alone says nothing: for a program that is frozen, the kernel accepts it.
"""

import socket
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

ANSWER_S = 0.7
PERIOD_S = 2.0
MOST_MISSES = 3

# RFC 9113: a frame is length (3 bytes), type, flags, stream (4 bytes), then its payload.
_HEAD = 9
_SETTINGS, _PING = 4, 6
_ACK = 1
_LARGEST = 16_384  # payload; a peer may send more only where it was allowed to, section 4.2
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # section 3.4


class Presence(Protocol):
    """Asks whether pictures would be taken."""

    def begin(self) -> bool:
        """Look for a viewer. False if there is none; takes up to two seconds to find out."""

    def answers(self) -> bool:
        """Whether it answers now. Raises ConnectionError if it has ended since `begin`."""

    def end(self) -> None:
        """Ask no more."""


class AlwaysThere:
    """A file, or a server of our own."""

    def begin(self) -> bool:
        """It is there."""
        return True

    def answers(self) -> bool:
        """It would."""
        return True

    def end(self) -> None:
        """Nothing to let go of."""


class ViewerPresence:
    """A connection that is held open: it breaks when the viewer ends."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._received = b""
        self._pings = count()

    def begin(self) -> bool:
        """Connect anew. False if nothing that speaks gRPC answers in time."""
        self.end()
        try:
            self._socket = socket.create_connection(self._address, ANSWER_S)
            self._socket.sendall(_PREFACE + _frame(_SETTINGS))
            self._wait_for(lambda frame: frame[3] == _SETTINGS)
            self._socket.sendall(_frame(_SETTINGS, _ACK))
        except (OSError, OverflowError, UnicodeError):
            self.end()
            return False
        return True

    def answers(self) -> bool:
        """Whether it answers in time. Raises ConnectionError if it has ended since `begin`."""
        if self._socket is None:
            raise ConnectionError
        answer = _frame(_PING, _ACK, next(self._pings).to_bytes(8, "big"))
        try:
            self._socket.sendall(_frame(_PING, 0, answer[_HEAD:]))
            self._wait_for(lambda frame: frame == answer)
        except TimeoutError:
            return False
        return True

    def end(self) -> None:
        """Let go of the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self._received = None, b""

    def _wait_for(self, is_it: Callable[[bytes], bool]) -> None:
        """Read up to a certain frame. Raises OSError, TimeoutError among them."""
        due_s = time.monotonic() + ANSWER_S
        while not is_it(self._next_frame(due_s)):
            pass

    def _next_frame(self, due_s: float) -> bytes:
        while (size := _size(self._received)) > len(self._received):
            assert self._socket is not None
            left_s = due_s - time.monotonic()
            if left_s <= 0.0:
                raise TimeoutError
            self._socket.settimeout(left_s)
            data = self._socket.recv(4096)
            if not data:
                raise ConnectionError
            self._received += data
        frame, self._received = self._received[:size], self._received[size:]
        return frame


class Watch:
    """Asks now and then; one that answers too late is given another chance."""

    def __init__(self, presence: Presence) -> None:
        self._presence = presence
        self._asked_s = 0.0
        self._misses = 0

    def begin(self) -> bool:
        """Look for a viewer. False if there is none."""
        self._asked_s, self._misses = time.monotonic(), 0
        return self._presence.begin()

    def has_gone(self) -> bool:
        """Whether the viewer has ended, or not answered several times in a row."""
        if time.monotonic() - self._asked_s < PERIOD_S:
            return False
        self._asked_s = time.monotonic()
        try:
            self._misses = 0 if self._presence.answers() else self._misses + 1
        except OSError:
            return True
        return self._misses >= MOST_MISSES

    def end(self) -> None:
        """Ask no more."""
        self._presence.end()


def _frame(kind: int, flags: int = 0, payload: bytes = b"") -> bytes:
    """A frame of the connection as a whole, which is stream 0."""
    return len(payload).to_bytes(3, "big") + bytes([kind, flags]) + bytes(4) + payload


def _size(received: bytes) -> int:
    """Of the frame that begins here; the size of a head until that is there.

    Raises ConnectionError for a frame that nobody may send.
    """
    if len(received) < _HEAD:
        return _HEAD
    length = int.from_bytes(received[:3], "big")
    if length > _LARGEST:
        raise ConnectionError(f"a frame of {length} bytes")
    return _HEAD + length
