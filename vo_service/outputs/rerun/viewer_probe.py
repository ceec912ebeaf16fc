"""Whether a Rerun viewer is there, and still the same: spoken to in HTTP/2, as gRPC does.

A connection alone says nothing: for a program that is frozen, the kernel accepts it.
"""

import socket
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

REPLY_TIMEOUT_S = 0.7
PROBE_PERIOD_S = 2.0
MAX_MISSED_REPLIES = 3

# RFC 9113: a frame is length (3 bytes), type, flags, stream (4 bytes), then its payload.
_FRAME_HEADER_BYTES = 9
_SETTINGS, _PING = 4, 6
_ACK = 1
_MAX_PAYLOAD_BYTES = (
    16_384  # payload; a peer may send more only where it was allowed to, section 4.2
)
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # section 3.4


class ViewerProbe(Protocol):
    """Asks whether pictures would be taken."""

    def connect(self) -> bool:
        """Look for a viewer. False if there is none; takes up to two seconds to find out."""

    def is_responding(self) -> bool:
        """Whether it answers now. Raises ConnectionError if it has ended since `begin`."""

    def disconnect(self) -> None:
        """Ask no more."""


class AlwaysPresent:
    """A file, or a server of our own."""

    def connect(self) -> bool:
        """It is there."""
        return True

    def is_responding(self) -> bool:
        """It would."""
        return True

    def disconnect(self) -> None:
        """Nothing to let go of."""


class GrpcViewerProbe:
    """A connection that is held open: it breaks when the viewer ends."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._received = b""
        self._pings = count()

    def connect(self) -> bool:
        """Connect anew. False if nothing that speaks gRPC answers in time."""
        self.disconnect()
        try:
            self._socket = socket.create_connection(self._address, REPLY_TIMEOUT_S)
            self._socket.sendall(_PREFACE + _encode_frame(_SETTINGS))
            self._wait_for(lambda frame: frame[3] == _SETTINGS)
            self._socket.sendall(_encode_frame(_SETTINGS, _ACK))
        except (OSError, OverflowError, UnicodeError):
            self.disconnect()
            return False
        return True

    def is_responding(self) -> bool:
        """Whether it answers in time. Raises ConnectionError if it has ended since `begin`."""
        if self._socket is None:
            raise ConnectionError
        answer = _encode_frame(_PING, _ACK, next(self._pings).to_bytes(8, "big"))
        try:
            self._socket.sendall(_encode_frame(_PING, 0, answer[_FRAME_HEADER_BYTES:]))
            self._wait_for(lambda frame: frame == answer)
        except TimeoutError:
            return False
        return True

    def disconnect(self) -> None:
        """Let go of the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self._received = None, b""

    def _wait_for(self, is_expected: Callable[[bytes], bool]) -> None:
        """Read up to a certain frame. Raises OSError, TimeoutError among them."""
        due_s = time.monotonic() + REPLY_TIMEOUT_S
        while not is_expected(self._next_frame(due_s)):
            pass

    def _next_frame(self, due_s: float) -> bytes:
        while (size := _frame_size(self._received)) > len(self._received):
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


class ViewerHealthMonitor:
    """Asks now and then; one that answers too late is given another chance."""

    def __init__(self, probe: ViewerProbe) -> None:
        self._probe = probe
        self._last_probe_s = 0.0
        self._misses = 0

    def connect(self) -> bool:
        """Look for a viewer. False if there is none."""
        self._last_probe_s, self._misses = time.monotonic(), 0
        return self._probe.connect()

    def has_gone(self) -> bool:
        """Whether the viewer has ended, or not answered several times in a row."""
        if time.monotonic() - self._last_probe_s < PROBE_PERIOD_S:
            return False
        self._last_probe_s = time.monotonic()
        try:
            self._misses = 0 if self._probe.is_responding() else self._misses + 1
        except OSError:
            return True
        return self._misses >= MAX_MISSED_REPLIES

    def disconnect(self) -> None:
        """Ask no more."""
        self._probe.disconnect()


def _encode_frame(kind: int, flags: int = 0, payload: bytes = b"") -> bytes:
    """A frame of the connection as a whole, which is stream 0."""
    return len(payload).to_bytes(3, "big") + bytes([kind, flags]) + bytes(4) + payload


def _frame_size(received: bytes) -> int:
    """Of the frame that begins here; the size of a head until that is there.

    Raises ConnectionError for a frame that nobody may send.
    """
    if len(received) < _FRAME_HEADER_BYTES:
        return _FRAME_HEADER_BYTES
    length = int.from_bytes(received[:3], "big")
    if length > _MAX_PAYLOAD_BYTES:
        raise ConnectionError(f"a frame of {length} bytes")
    return _FRAME_HEADER_BYTES + length
