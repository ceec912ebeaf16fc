"""The output `distance:FILE`: how far the camera has gone, in a text file."""

from pathlib import Path

import numpy as np

from drivers.camera import PlaybackMode
from drivers.core import InputError
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate


class DistanceOutput:
    """Adds up the way of the camera, and writes it when the service stops.

    Args:
        argument: The file.
        playback_mode: In lockstep an output may block; this one never does.

    Raises:
        InputError: If the file cannot be written.
    """

    def __init__(self, argument: str, playback_mode: PlaybackMode) -> None:
        self.warning = ""
        self._path, self._distance_m = Path(argument), 0.0
        self._last_position: np.ndarray | None = None
        self.close()

    def on_update(self, update: OdometryUpdate) -> None:
        """Add the way since the last pose; a jump is not a way."""
        estimate = update.estimate
        if not estimate.ok:
            return
        position = estimate.T_world_camera[:3, 3]
        if self._last_position is not None and not estimate.is_reset:
            self._distance_m += float(np.linalg.norm(position - self._last_position))
        self._last_position = position.copy()

    def on_status(self, status: Status) -> None:
        """Do nothing: updates have the poses."""

    def close(self) -> None:
        """Write the file."""
        try:
            self._path.write_text(f"{self._distance_m:.3f} m\n")
        except OSError as error:
            raise InputError(f"output distance: {self._path}: {error.strerror}") from error
