"""Changes of state in the log: a line when tracking or the camera is lost and when it is back."""

import logging
import math
import time

from drivers.camera import CameraState
from vo_service.announcements import SLOW_AFTER_S, announce
from vo_service.types import OdometryUpdate, Status, TrackingState

CONNECTING_STATES = (CameraState.OPENING, CameraState.STARTING)

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble, and its end, as a warning.

    How things are at the start is no news, nor is a camera that is being opened, unless that takes
    long; its first frame is then told with the seconds. Why there is no camera is news, whenever it
    changes; and once in a state, what a camera complains of while it sends.
    """

    warning = ""

    def __init__(self) -> None:
        self._last_logged: tuple[TrackingState, str] | None = None
        self._is_faulty = self._has_camera_warning = False
        self._absence = _CameraAbsence()

    def on_update(self, update: OdometryUpdate) -> None:
        """Nothing: the status tells of every change."""

    def on_status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_away = status.state is TrackingState.NO_CAMERA
        is_tracking = status.state is TrackingState.TRACKING
        is_coming = is_away and status.reason.partition(":")[0] in CONNECTING_STATES
        took = self._absence.update(status, is_away, is_coming)
        news = (status.state, status.reason if is_away else "")
        before, self._last_logged = self._last_logged, news
        had_complained = self._has_camera_warning and before == news
        complains = is_tracking and status.reason != ""
        self._has_camera_warning = had_complained or complains
        if before is None or (before == news and self._has_camera_warning == had_complained):
            return
        was_in_trouble = self._is_faulty
        if not is_coming:
            self._is_faulty = not is_tracking or complains
        is_news = (was_in_trouble or self._is_faulty) and not is_coming
        text = _status_text(status) + took
        if is_news:
            logger.warning("%s", text)
        elif took:
            announce(text)
        else:
            logger.info("%s", text)

    def close(self) -> None:
        """Nothing to release."""


class _CameraAbsence:
    """How long there has been no camera."""

    def __init__(self) -> None:
        self._since_s = math.inf
        self._is_announced = False

    def update(self, status: Status, is_absent: bool, is_connecting: bool) -> str:
        """Tell of a camera that has been coming for long; when it is there, how long that took."""
        now_s = time.monotonic()
        is_long = now_s - self._since_s >= SLOW_AFTER_S
        if not is_absent:
            took = f" (no camera for {now_s - self._since_s:.1f} s)" if is_long else ""
            self._since_s, self._is_announced = math.inf, False
            return took
        self._since_s = min(self._since_s, now_s)
        if is_long and is_connecting and not self._is_announced:
            self._is_announced = True
            announce(f"{_status_text(status)} ...")
        return ""


def _status_text(status: Status) -> str:
    return f"{status.state}: {status.reason}" if status.reason else str(status.state)
