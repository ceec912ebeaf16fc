"""Changes of state in the log: a line when tracking or the camera is lost and when it is back."""

import logging

from drivers.camera import CameraState
from vo_service.outputs.output import PoseUpdate, Status, TrackingState

COMING = (CameraState.OPENING, CameraState.STARTING)

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble, and its end, as a warning.

    How things are at the start is no news, nor is a camera that is being opened. Why there is no
    camera is, whenever it changes.
    """

    def __init__(self) -> None:
        self._told: tuple[TrackingState, str] | None = None
        self._in_trouble = False

    def pose(self, update: PoseUpdate) -> None:
        """Nothing: the status tells of every change."""

    def status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_away = status.state is TrackingState.NO_CAMERA
        news = (status.state, status.reason if is_away else "")
        before, self._told = self._told, news
        if before in (None, news):
            return
        was_in_trouble, is_coming = self._in_trouble, is_away and status.reason in COMING
        if not is_coming:
            self._in_trouble = status.state is not TrackingState.TRACKING
        is_news = (was_in_trouble or self._in_trouble) and not is_coming
        level = logging.WARNING if is_news else logging.INFO
        reason = f": {status.reason}" if status.reason else ""
        logger.log(level, "%s%s", status.state, reason)

    def close(self) -> None:
        """Nothing to release."""
