"""Protocols of the outputs and of the parts that take commands, and their null objects."""

from collections.abc import Callable
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.core.geometry import Trajectory
from vo_service.config_tables import MapConfig, RecorderConfig
from vo_service.types.commands import NotPossibleError
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.messages import MapState, Status
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid
from vo_service.types.odometry import Odometry
from vo_service.types.odometry_update import OdometryUpdate

# Returns the ground truth, or None. Called after the first frame: before it, a live camera's ground
# truth has no stamps.
GroundTruthSource = Callable[[], Trajectory | None]


def no_ground_truth() -> Trajectory | None:
    """Return None: the ground truth is unknown."""
    return None


class HasWarning(Protocol):
    """A part with a warning for the status."""

    @property
    def warning(self) -> str:
        """The present fault in one clause; "" = none."""
        ...


class Output(HasWarning, Protocol):
    """A sink for updates and the status. No method blocks the caller for long.

    `on_update` and `on_status` never raise: an output that fails logs the fault once and sets
    `warning`.
    """

    def on_update(self, update: OdometryUpdate) -> None:
        """Take the update of one frame."""
        ...

    def on_status(self, status: Status) -> None:
        """Take the service's status: twice a second and on change."""
        ...

    def close(self) -> None:
        """Finish pending work and release everything. Safe to call twice.

        Raises:
            UserFacingError: On the first call, if data was lost.
        """
        ...


class OutputBase:
    """Base of outputs that need only some methods of `Output`; the others do nothing.

    Attributes:
        warning: Fault for the status; "" = none.
    """

    warning = ""

    def on_update(self, update: OdometryUpdate) -> None:
        """Ignore the update."""

    def on_status(self, status: Status) -> None:
        """Ignore the status."""

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class PausableViewer(Protocol):
    """A viewer that can be paused to save CPU time."""

    def set_paused(self, is_paused: bool) -> None:
        """Pause the viewer, or resume it. Does not block."""
        ...


class Recorder(Output, Protocol):
    """An output that keeps recent frames and can write them to a folder."""

    @property
    def recording(self) -> str:
        """Folder of the current recording; "" = none."""
        ...

    def save(self, reason: str) -> str:
        """Start to write the last seconds into a folder. Does not wait for the end.

        Args:
            reason: Cause of the incident; part of the folder's name.

        Returns:
            Path of the folder.

        Raises:
            CommandError: If that is not possible now.
        """
        ...

    def start_recording(self, name: str) -> str:
        """Start to record into a new folder. Does not wait for the first frame.

        Returns:
            Path of the folder.

        Raises:
            CommandError: If the name is not valid, or if that is not possible now.
        """
        ...

    def stop_recording(self) -> str:
        """End the current recording.

        Returns:
            Path of its folder.

        Raises:
            CommandError: If there is no recording.
        """
        ...

    def configure(self, settings: RecorderConfig) -> None:
        """Apply the settings that may change while it runs: `save_on_loss` and `total_mb`."""
        ...


class NullRecorder(OutputBase):
    """Null recorder: commands fail with the given reason."""

    recording = ""

    def __init__(self, reason: str = "there is no flight recorder", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def save(self, reason: str) -> str:
        """Raise CommandError with the given reason."""
        raise NotPossibleError(self._reason)

    def start_recording(self, name: str) -> str:
        """Raise CommandError with the given reason."""
        raise NotPossibleError(self._reason)

    def stop_recording(self) -> str:
        """Raise CommandError with the given reason."""
        raise NotPossibleError(self._reason)

    def configure(self, settings: RecorderConfig) -> None:
        """Ignore the settings."""


class LoopClosure(Protocol):
    """Loop closure: the map of keyframes, and the drift of `odom` in it."""

    @property
    def snapshot(self) -> MapSnapshot:
        """The present map; the same object until the map changes."""
        ...

    def wrap(self, odometry: Odometry) -> Odometry:
        """Return the odometry with relocalization in the map after a loss of tracking."""
        ...


class NullLoopClosure:
    """Null loop closure: an empty map, and no relocalization."""

    snapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """Return the odometry unchanged."""
        return odometry


class Mapper(Output, Protocol):
    """An output that keeps keyframes, and can save and load maps."""

    @property
    def loop_closure(self) -> LoopClosure:
        """Loop closure with the mapper's keyframes."""
        ...

    @property
    def state(self) -> MapState:
        """The present state."""
        ...

    @property
    def grid(self) -> OccupancyGrid:
        """The occupancy grid; the same object until it changes."""
        ...

    def save(self, name: str) -> MapState:
        """Start to mesh and save the map. Does not wait for the end.

        Returns:
            The state from then on; `saving` is the file.

        Raises:
            CommandError: If the name is not valid, or if that is not possible now.
        """
        ...

    def load(self, name: str) -> MapState:
        """Start to load the keyframes of a saved map. Does not wait for the end.

        Returns:
            The state from then on; `loading` is the file.

        Raises:
            CommandError: If there is no such map, or if that is not possible now.
        """
        ...

    def configure(self, settings: MapConfig) -> None:
        """Apply the settings that may change while it runs.

        These are all but `enabled`, `loop_closure`, `load` and `keyframe_database_mb`.
        """
        ...


class NullMapper(OutputBase):
    """Null mapper: commands fail with the given reason."""

    state = MapState()
    grid = NO_GRID
    loop_closure = NullLoopClosure()

    def __init__(self, reason: str = "there is no map", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def save(self, name: str) -> MapState:
        """Raise CommandError with the given reason."""
        raise NotPossibleError(self._reason)

    def load(self, name: str) -> MapState:
        """Raise CommandError with the given reason."""
        raise NotPossibleError(self._reason)

    def configure(self, settings: MapConfig) -> None:
        """Ignore the settings."""


class SensorMemory(Output, Protocol):
    """An output that remembers what was learned of each sensor, by its serial number."""

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with what an earlier run has learned, if nothing better is told."""
        ...


class NullSensorMemory(OutputBase):
    """Null memory: nothing is used or saved."""

    def __init__(self, warning: str = "") -> None:
        self.warning = warning

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame unchanged."""
        return frame
