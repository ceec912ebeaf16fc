"""Changes of state in the log."""

import logging
import math
import time

from drivers.camera import CameraState
from vo_service.frame_source import RECORDING_ENDED
from vo_service.terminal import SLOW_AFTER_S, announce
from vo_service.types.messages import Status
from vo_service.types.odometry_update import TrackingState
from vo_service.types.outputs import OutputBase

logger = logging.getLogger(__name__)
CONNECTING_STATES = (CameraState.OPENING, CameraState.STARTING)


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
