"""Probe of a Rerun viewer over HTTP/2, the protocol under gRPC.

A TCP connection alone is no proof: the kernel accepts it even if the viewer is frozen.
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
_MAX_PAYLOAD_BYTES = 16_384  # section 4.2: a peer may send more only if it was allowed to
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # section 3.4


class ViewerProbe(Protocol):
    """Checks whether a viewer accepts data."""

    def connect(self) -> bool:
        """Connect to a viewer. Return False if there is none; may take two seconds."""

    def is_responding(self) -> bool:
        """Return whether it responds.

        Raises:
            ConnectionError: If it has exited since `connect`.
        """

    def disconnect(self) -> None:
        """Close the connection."""


class AlwaysPresent:
    """Probe of a file or of this process's own server."""

    def connect(self) -> bool:
        """Return True."""
        return True

    def is_responding(self) -> bool:
        """Return True."""
        return True

    def disconnect(self) -> None:
        """Do nothing."""


class GrpcViewerProbe:
    """Probe that keeps a connection open, which breaks when the viewer exits."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._received = b""
        self._pings = count()

    def connect(self) -> bool:
        """Reconnect. Return False if no gRPC server responds in time."""
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
        """Return whether it responds.

        Raises:
            ConnectionError: If it has exited since `connect`.
        """
        if self._socket is None:
            raise ConnectionError
        reply = _encode_frame(_PING, _ACK, next(self._pings).to_bytes(8, "big"))
        try:
            self._socket.sendall(_encode_frame(_PING, 0, reply[_FRAME_HEADER_BYTES:]))
            self._wait_for(lambda frame: frame == reply)
        except TimeoutError:
            return False
        return True

    def disconnect(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self._received = None, b""

    def _wait_for(self, is_expected: Callable[[bytes], bool]) -> None:
        """Read up to the expected frame. Raises OSError, also TimeoutError."""
        due_s = time.monotonic() + REPLY_TIMEOUT_S
        while not is_expected(self._next_frame(due_s)):
            pass

    def _next_frame(self, due_s: float) -> bytes:
        while (size := _frame_size(self._received)) > len(self._received):
            assert self._socket is not None
            remaining_s = due_s - time.monotonic()
            if remaining_s <= 0.0:
                raise TimeoutError
            self._socket.settimeout(remaining_s)
            data = self._socket.recv(4096)
            if not data:
                raise ConnectionError
            self._received += data
        frame, self._received = self._received[:size], self._received[size:]
        return frame


class ViewerHealthMonitor:
    """Periodic health check; a viewer may miss a few replies."""

    def __init__(self, probe: ViewerProbe) -> None:
        self._probe = probe
        self._last_probe_s = 0.0
        self._misses = 0

    def connect(self) -> bool:
        """Connect to a viewer. Return False if there is none."""
        self._last_probe_s, self._misses = time.monotonic(), 0
        return self._probe.connect()

    def has_gone(self) -> bool:
        """Return whether the viewer has exited or missed several replies in a row."""
        if time.monotonic() - self._last_probe_s < PROBE_PERIOD_S:
            return False
        self._last_probe_s = time.monotonic()
        try:
            self._misses = 0 if self._probe.is_responding() else self._misses + 1
        except OSError:
            return True
        return self._misses >= MAX_MISSED_REPLIES

    def disconnect(self) -> None:
        """Close the connection."""
        self._probe.disconnect()


def _encode_frame(kind: int, flags: int = 0, payload: bytes = b"") -> bytes:
    """Encode a frame of stream 0, the connection as a whole."""
    return len(payload).to_bytes(3, "big") + bytes([kind, flags]) + bytes(4) + payload


def _frame_size(received: bytes) -> int:
    """Return the size of the frame at the start, or of its header while that is incomplete.

    Raises:
        ConnectionError: The frame is too large.
    """
    if len(received) < _FRAME_HEADER_BYTES:
        return _FRAME_HEADER_BYTES
    length = int.from_bytes(received[:3], "big")
    if length > _MAX_PAYLOAD_BYTES:
        raise ConnectionError(f"a frame of {length} bytes")
    return _FRAME_HEADER_BYTES + length
