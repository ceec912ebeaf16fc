"""Outputs for people: progress on a terminal, and a log line for each change of state."""

import logging
import math
import time

from drivers.camera import CameraState
from vo_service.frame_source import RECORDING_ENDED
from vo_service.terminal import SLOW_AFTER_S, Terminal, announce
from vo_service.types import OdometryUpdate, TrackingState
from vo_service.types.messages import Status

logger = logging.getLogger(__name__)
CONNECTING_STATES = (CameraState.OPENING, CameraState.STARTING)


class ProgressOutput:
    """Draws the frame count, the state and the inliers. It writes nothing to the log."""

    warning = ""

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


class StateLogOutput:
    """Logs each change of state once; a fault and its end are warnings.

    The first state is not logged, nor is a camera that opens fast; a slow one is logged with its
    time. A new reason for the missing camera is logged each time. A warning of a running camera is
    logged once per state.
    """

    warning = ""

    def __init__(self) -> None:
        self._last_logged: tuple[TrackingState, str] | None = None
        self._is_faulty = self._has_camera_warning = False
        self._absence = _CameraAbsence()

    def on_update(self, update: OdometryUpdate) -> None:
        """Do nothing: the status holds every change."""

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

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


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
