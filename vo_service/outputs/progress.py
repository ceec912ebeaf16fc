"""Progress on the terminal."""

from vo_service.terminal import Terminal
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.types.outputs import OutputBase


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
