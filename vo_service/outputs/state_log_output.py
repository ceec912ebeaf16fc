"""Changes of state in the log: a line when tracking or the camera is lost and when it is back."""

import logging

from drivers.camera import CameraState
from vo_service.outputs.output import PoseUpdate, Status, TrackingState

COMING = (CameraState.OPENING, CameraState.STARTING)

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble, and its end, as a warning.

    How things are at the start is no news, nor is a camera that is being opened. Why there is no
    camera is, whenever it changes; and once in a state, what a camera complains of while it sends.
    """

    warning = ""

    def __init__(self) -> None:
        self._told: tuple[TrackingState, str] | None = None
        self._in_trouble = self._has_complained = False

    def pose(self, update: PoseUpdate) -> None:
        """Nothing: the status tells of every change."""

    def status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_away = status.state is TrackingState.NO_CAMERA
        is_tracking = status.state is TrackingState.TRACKING
        news = (status.state, status.reason if is_away else "")
        before, self._told = self._told, news
        had_complained = self._has_complained and before == news
        complains = is_tracking and status.reason != ""
        self._has_complained = had_complained or complains
        if before is None or (before == news and self._has_complained == had_complained):
            return
        was_in_trouble, is_coming = self._in_trouble, is_away and status.reason in COMING
        if not is_coming:
            self._in_trouble = not is_tracking or complains
        is_news = (was_in_trouble or self._in_trouble) and not is_coming
        reason = f": {status.reason}" if status.reason else ""
        logger.log(logging.WARNING if is_news else logging.INFO, "%s%s", status.state, reason)

    def close(self) -> None:
        """Nothing to release."""
