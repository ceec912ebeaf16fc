"""Notifications to systemd."""

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from vo_service.types.messages import Status
from vo_service.types.outputs import OutputBase

MAX_STATUS_CHARS = 500


class SystemdNotifier:
    """Socket to systemd, see sd_notify(3); without systemd it does nothing.

    It never blocks and never raises: a message that cannot be sent is lost.
    """

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if self._address.startswith("@"):  # an abstract address, which has no file
            self._address = f"\0{self._address[1:]}"

    def send(self, *lines: str) -> bool:
        """Send lines such as ``READY=1``; return whether they were sent."""
        if not self._address:
            return False
        try:
            self._socket.sendto("\n".join(lines).encode(errors="replace"), self._address)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Release the socket."""
        self._address = ""
        self._socket.close()


class SystemdOutput(OutputBase):
    """Reports ready at the first status; each status feeds the watchdog and `systemctl status`.

    Nothing else feeds the watchdog, so systemd restarts a loop that hangs.
    """

    def __init__(self) -> None:
        self._notifier = SystemdNotifier()
        self._is_ready = False

    def on_status(self, status: Status) -> None:
        """Feed the watchdog."""
        ready = [] if self._is_ready else ["READY=1"]
        self._is_ready |= self._notifier.send(
            *ready, "WATCHDOG=1", f"STATUS={_status_line(status)}"
        )

    @contextmanager
    def notify_reloading(self) -> Iterator[None]:
        """Report a reload while the block runs."""
        now_us = time.monotonic_ns() // 1000
        self._notifier.send("RELOADING=1", f"MONOTONIC_USEC={now_us}")
        try:
            yield
        finally:
            self._notifier.send("READY=1")

    def close(self) -> None:
        """Report that the service stops, and release the socket. Systemd waits `TimeoutStopSec`."""
        self._notifier.send("STOPPING=1", "STATUS=stopping")
        self._notifier.close()


def _status_line(status: Status) -> str:
    """Format state, reason, rate and warnings as one line."""
    parts = [f"{status.state}: {status.reason}" if status.reason else f"{status.state}"]
    parts += ["paused"] if status.paused else []
    parts += [f"{status.latency.fps:.0f} poses/s", *status.warnings]
    return " ".join("; ".join(parts).split())[:MAX_STATUS_CHARS]
