"""Changes of state in the log: a line when tracking or the camera is lost and when it is back."""

import logging
import math
import time

from drivers.camera import CameraState
from vo_service.announcements import LONG_S, announce
from vo_service.types import PoseUpdate, Status, TrackingState

COMING = (CameraState.OPENING, CameraState.STARTING)

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble, and its end, as a warning.

    How things are at the start is no news, nor is a camera that is being opened, unless that takes
    long; its first frame is then told with the seconds. Why there is no camera is news, whenever it
    changes; and once in a state, what a camera complains of while it sends.
    """

    warning = ""

    def __init__(self) -> None:
        self._told: tuple[TrackingState, str] | None = None
        self._in_trouble = self._has_complained = False
        self._absence = _Absence()

    def pose(self, update: PoseUpdate) -> None:
        """Nothing: the status tells of every change."""

    def status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_away = status.state is TrackingState.NO_CAMERA
        is_tracking = status.state is TrackingState.TRACKING
        is_coming = is_away and status.reason.partition(":")[0] in COMING
        took = self._absence.note(status, is_away, is_coming)
        news = (status.state, status.reason if is_away else "")
        before, self._told = self._told, news
        had_complained = self._has_complained and before == news
        complains = is_tracking and status.reason != ""
        self._has_complained = had_complained or complains
        if before is None or (before == news and self._has_complained == had_complained):
            return
        was_in_trouble = self._in_trouble
        if not is_coming:
            self._in_trouble = not is_tracking or complains
        is_news = (was_in_trouble or self._in_trouble) and not is_coming
        text = _text(status) + took
        if is_news:
            logger.warning("%s", text)
        elif took:
            announce(text)
        else:
            logger.info("%s", text)

    def close(self) -> None:
        """Nothing to release."""


class _Absence:
    """How long there has been no camera."""

    def __init__(self) -> None:
        self._since_s = math.inf
        self._is_told = False

    def note(self, status: Status, is_away: bool, is_coming: bool) -> str:
        """Tell of a camera that has been coming for long; when it is there, how long that took."""
        now_s = time.monotonic()
        is_long = now_s - self._since_s >= LONG_S
        if not is_away:
            took = f" (no camera for {now_s - self._since_s:.1f} s)" if is_long else ""
            self._since_s, self._is_told = math.inf, False
            return took
        self._since_s = min(self._since_s, now_s)
        if is_long and is_coming and not self._is_told:
            self._is_told = True
            announce(f"{_text(status)} ...")
        return ""


def _text(status: Status) -> str:
    return f"{status.state}: {status.reason}" if status.reason else str(status.state)
