"""Outputs: Zenoh, Rerun, recorder, trajectory file. Each takes poses and status until closed.

Here: the outputs for who runs the program: progress and log lines for people, notifications to
systemd.
"""

import logging
import math
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.camera import CameraState
from vo_service.frame_source import RECORDING_ENDED
from vo_service.terminal import SLOW_AFTER_S, Terminal, announce
from vo_service.types import OdometryUpdate, TrackingState
from vo_service.types.messages import Status
from vo_service.types.outputs import OutputBase

logger = logging.getLogger(__name__)
CONNECTING_STATES = (CameraState.OPENING, CameraState.STARTING)


class ProgressOutput(OutputBase):
    """Draws the frame count, the state and the inliers. It writes nothing to the log."""

    def __init__(self, terminal: Terminal, label: str, total: int | None) -> None:
        self._terminal = terminal
        self._label = label
        self._total = total

    def on_update(self, update: OdometryUpdate) -> None:
        """Count one frame."""
        label = f"{self._label}: {update.state}, {update.estimate.inliers} inliers, frame"
        self._terminal.progress(label, update.frame.seq + 1, self._total)

    def on_status(self, status: Status) -> None:
        """Draw why there is no camera; with a camera, `on_update` draws."""
        if status.state is TrackingState.NO_CAMERA:
            self._terminal.show(f"{self._label}: {status.reason}")

    def close(self) -> None:
        """Clear the line."""
        self._terminal.clear()


class StateLogOutput(OutputBase):
    """Logs each change of state once; a fault and its end are warnings.

    The first state is not logged, nor is a camera that opens fast; a slow one is logged with its
    time. A new reason for the missing camera is logged each time. A warning of a running camera is
    logged once per state.
    """

    def __init__(self) -> None:
        self._last_logged: tuple[TrackingState, str] | None = None
        self._is_faulty = self._has_camera_warning = False
        self._absence = _CameraAbsence()

    def on_status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_absent = status.state is TrackingState.NO_CAMERA
        is_tracking = status.state is TrackingState.TRACKING
        is_connecting = is_absent and status.reason.partition(":")[0] in CONNECTING_STATES
        duration = self._absence.update(status, is_absent, is_connecting)
        current = (status.state, status.reason if is_absent else "")
        previous, self._last_logged = self._last_logged, current
        had_warning = self._has_camera_warning and previous == current
        has_warning = is_tracking and status.reason != ""
        self._has_camera_warning = had_warning or has_warning
        if previous is None or (previous == current and self._has_camera_warning == had_warning):
            return
        was_faulty = self._is_faulty
        if not is_connecting:
            self._is_faulty = not is_tracking or has_warning
        text = _status_text(status) + duration
        if (was_faulty or self._is_faulty) and not is_connecting:
            logger.warning("%s", text)
        elif duration:
            announce(text)
        else:
            logger.info("%s", text)


class _CameraAbsence:
    """Timer of how long there has been no camera."""

    def __init__(self) -> None:
        self._since_s = math.inf
        self._is_announced = False

    def update(self, status: Status, is_absent: bool, is_connecting: bool) -> str:
        """Announce a camera that opens slowly; once it is there, return how long it took."""
        now_s = time.monotonic()
        is_long = now_s - self._since_s >= SLOW_AFTER_S
        if not is_absent:
            duration = f" (after {now_s - self._since_s:.1f} s without a camera)" if is_long else ""
            self._since_s, self._is_announced = math.inf, False
            return duration
        self._since_s = min(self._since_s, now_s)
        if is_long and is_connecting and not self._is_announced:
            self._is_announced = True
            announce(f"{_status_text(status)} ...")
        return ""


def _status_text(status: Status) -> str:
    hint = "; Ctrl-C ends the service" if status.reason == RECORDING_ENDED else ""
    return f"{status.state}: {status.reason}{hint}" if status.reason else str(status.state)


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

    def notify_stopping(self) -> None:
        """Report that the service stops; systemd then waits `TimeoutStopSec`."""
        self._notifier.send("STOPPING=1", "STATUS=stopping")

    def close(self) -> None:
        """Report that the service stops, and release the socket."""
        self.notify_stopping()
        self._notifier.close()


def _status_line(status: Status) -> str:
    """Format state, reason, rate and warnings as one line."""
    parts = [f"{status.state}: {status.reason}" if status.reason else f"{status.state}"]
    parts += ["paused"] if status.paused else []
    parts += [f"{status.timing.fps:.0f} poses/s", *status.warnings]
    return " ".join("; ".join(parts).split())[:MAX_STATUS_CHARS]
