"""Telling systemd how the service is: sd_notify, and an output that feeds the watchdog."""

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from vo_service.types import OdometryUpdate, Status

MAX_STATUS_CHARS = 500


class SystemdNotifier:
    """The socket on which systemd listens; where there is none, nothing happens.

    See sd_notify(3). Never blocks and never raises: a message that cannot be sent is lost.
    """

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if self._address.startswith("@"):  # an abstract address, which has no file
            self._address = f"\0{self._address[1:]}"

    def send(self, *lines: str) -> bool:
        """Send lines such as ``READY=1``; whether they went out."""
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


class SystemdOutput:
    """Ready with the first status; each status feeds the watchdog and is what `systemctl` shows.

    Nothing else feeds it: a loop that no longer comes round is killed and started again.
    """

    warning = ""

    def __init__(self) -> None:
        self._notifier = SystemdNotifier()
        self._is_ready = False

    def on_update(self, update: OdometryUpdate) -> None:
        """Nothing: the watchdog is fed without frames too."""

    def on_status(self, status: Status) -> None:
        """Feed the watchdog."""
        ready = [] if self._is_ready else ["READY=1"]
        self._is_ready |= self._notifier.send(
            *ready, "WATCHDOG=1", f"STATUS={_status_line(status)}"
        )

    @contextmanager
    def notify_reloading(self) -> Iterator[None]:
        """While the configuration is read again."""
        now_us = time.monotonic_ns() // 1000
        self._notifier.send("RELOADING=1", f"MONOTONIC_USEC={now_us}")
        try:
            yield
        finally:
            self._notifier.send("READY=1")

    def notify_stopping(self) -> None:
        """The service has begun to end; systemd then waits `TimeoutStopSec`."""
        self._notifier.send("STOPPING=1", "STATUS=stopping")

    def close(self) -> None:
        """Say that this is the end, and release the socket."""
        self.notify_stopping()
        self._notifier.close()


def _status_line(status: Status) -> str:
    """The status for a person: state, reason, rate, warnings."""
    parts = [f"{status.state}: {status.reason}" if status.reason else f"{status.state}"]
    parts += ["paused"] if status.paused else []
    parts += [f"{status.fps:.0f} poses/s", *status.warnings]
    return " ".join("; ".join(parts).split())[:MAX_STATUS_CHARS]
