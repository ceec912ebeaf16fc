"""What the service asks of those who take its results, and of those who work beside it."""

from collections.abc import Callable
from typing import Protocol

from drivers.core.trajectory import Trajectory
from vo_service.config_tables import MapConfig, RecorderConfig
from vo_service.types.commands import CommandError, ErrorCode
from vo_service.types.estimate import Odometry
from vo_service.types.status import MapState, Status
from vo_service.types.update import NO_MAP, MapSnapshot, OdometryUpdate

# Asked for the ground truth once frames come: a live camera's truth has no stamps before that.
GroundTruthSource = Callable[[], Trajectory | None]


def no_ground_truth() -> Trajectory | None:
    """Where the truth is not known."""
    return None


class HasWarning(Protocol):
    """Something that may have a complaint for the status."""

    @property
    def warning(self) -> str:
        """One clause that says what is wrong with it now; "" while all is well."""
        ...


class Output(HasWarning, Protocol):
    """Somewhere that poses go. None of the three blocks the caller for long.

    `pose` and `status` never raise: an output that fails logs it once, and says so in `warning`.
    """

    def on_update(self, update: OdometryUpdate) -> None:
        """Take one result."""
        ...

    def on_status(self, status: Status) -> None:
        """Take the service's status: twice a second and on change."""
        ...

    def close(self) -> None:
        """Finish what was taken and release everything. Safe to call twice.

        Raises UserFacingError, the first time, if something taken could not be kept.
        """
        ...


class PausableViewer(Protocol):
    """Something that shows pictures, and can do without."""

    def set_paused(self, is_paused: bool) -> None:
        """Show nothing from now on, or everything again. Does not block."""
        ...


class Recorder(Output, Protocol):
    """An output that can write out what it remembers."""

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        ...

    def save(self, reason: str) -> str:
        """Write the last seconds into a folder (soon), whose name is returned at once.

        Raises CommandError if that is not possible now.
        """
        ...

    def start_recording(self, name: str) -> str:
        """Record into a new folder of this name, which is returned with its path, at once.

        Raises CommandError if the name will not do, or if it is not possible now.
        """
        ...

    def stop_recording(self) -> str:
        """End the recording; its folder. Raises CommandError if there is none."""
        ...

    def configure(self, settings: RecorderConfig) -> None:
        """Take over what may change while it runs: `save_on_loss` and `total_mb`."""
        ...


class NullRecorder:
    """Where nothing is to be remembered, or nothing can be: says why to whoever asks."""

    recording = ""

    def __init__(self, reason: str = "there is no flight recorder", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def on_update(self, update: OdometryUpdate) -> None:
        """Nothing to remember."""

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, reason: str) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def start_recording(self, name: str) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def stop_recording(self) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def configure(self, settings: RecorderConfig) -> None:
        """Nothing to change."""

    def close(self) -> None:
        """Nothing to release."""


class LoopClosure(Protocol):
    """Knows where the camera has been, and how far `odom` has drifted since."""

    @property
    def snapshot(self) -> MapSnapshot:
        """The map as it is now; the same object as long as nothing has changed."""
        ...

    def wrap(self, odometry: Odometry) -> Odometry:
        """The same odometry, that finds back to places that are known."""
        ...


class NullLoopClosure:
    """Where no place is remembered."""

    snapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """As it is."""
        return odometry


class Mapper(Output, Protocol):
    """An output that remembers where the camera has been, and can make a map of it.

    loops  which places are known again
    """

    loop_closure: LoopClosure

    @property
    def state(self) -> MapState:
        """How it is now."""
        ...

    def save(self, name: str) -> MapState:
        """Begin to make a map of this name; the state from then on.

        Raises CommandError if the name will not do, or if it is not possible now.
        """
        ...

    def load(self, name: str) -> MapState:
        """Begin to know the places of the map of this name; the state from then on.

        Raises CommandError if there is none, or if it is not possible now.
        """
        ...

    def configure(self, settings: MapConfig) -> None:
        """Take over what may change while it runs: all but `enabled`, `loops` and `load`."""
        ...


class NullMapper:
    """Where there is to be no map, or can be none: says why to whoever asks."""

    state = MapState()
    loop_closure: LoopClosure = NullLoopClosure()

    def __init__(self, reason: str = "there is no map", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def on_update(self, update: OdometryUpdate) -> None:
        """Nothing to remember."""

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, name: str) -> MapState:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def load(self, name: str) -> MapState:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def configure(self, settings: MapConfig) -> None:
        """Nothing to change."""

    def close(self) -> None:
        """Nothing to release."""
