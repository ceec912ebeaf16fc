"""Changes of state in the log: a line when tracking is lost and when it is back."""

import logging

from vo_service.outputs.output import PoseUpdate, Status, TrackingState

logger = logging.getLogger(__name__)


class StateLogOutput:
    """Logs each change of state once: trouble as a warning, recovery as information."""

    def __init__(self) -> None:
        self._state = TrackingState.TRACKING

    def pose(self, update: PoseUpdate) -> None:
        """Nothing: the status tells of every change."""

    def status(self, status: Status) -> None:
        """Log the state if it differs from the one before."""
        if status.state is self._state:
            return
        self._state = status.state
        level = logging.INFO if status.state is TrackingState.TRACKING else logging.WARNING
        reason = f": {status.reason}" if status.reason else ""
        logger.log(level, "%s%s", status.state, reason)

    def close(self) -> None:
        """Nothing to release."""
