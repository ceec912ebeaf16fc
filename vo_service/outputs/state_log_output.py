"""Changes of state in the log: a line when tracking or the camera is lost and when it is back."""

import logging

from vo_service.outputs.output import PoseUpdate, Status, TrackingState

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble as a warning, recovery as information.

    How things are at the start is no news. Why there is no camera is, whenever it changes.
    """

    def __init__(self) -> None:
        self._told: tuple[TrackingState, str] | None = None

    def pose(self, update: PoseUpdate) -> None:
        """Nothing: the status tells of every change."""

    def status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        is_away = status.state is TrackingState.NO_CAMERA
        news = (status.state, status.reason if is_away else "")
        before, self._told = self._told, news
        if before in (None, news):
            return
        level = logging.INFO if status.state is TrackingState.TRACKING else logging.WARNING
        reason = f": {status.reason}" if status.reason else ""
        logger.log(level, "%s%s", status.state, reason)

    def close(self) -> None:
        """Nothing to release."""
