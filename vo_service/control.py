"""What changes the running service between two frames: commands, and load shedding.

Commands come from other threads, through a queue. While the loop is late, the viewers are paused.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from drivers.camera import RgbdCamera
from drivers.core import CameraError
from vo_service.config_tables import LoadConfig
from vo_service.odom_frame import OdomFrame
from vo_service.types.commands import (
    Command,
    CommandError,
    EpochReply,
    ErrorCode,
    FolderReply,
    LedCommand,
    LedReply,
    LoadedMapReply,
    LoadMapCommand,
    NoReply,
    NotPossibleError,
    PauseCommand,
    PausedReply,
    ReloadConfig,
    ResetCommand,
    ResumeCommand,
    SavedMapReply,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
    TiltReply,
)
from vo_service.types.messages import MapState
from vo_service.types.occupancy_grid import OccupancyGrid
from vo_service.types.outputs import Mapper, NullMapper, NullRecorder, PausableViewer, Recorder

logger = logging.getLogger(__name__)

MAX_PENDING_COMMANDS = 8


class CommandFuture:
    """A command and its reply: the loop sets the reply, the sender waits for it."""

    def __init__(self, command: Command) -> None:
        self.command = command
        self._is_done = threading.Event()
        self._reply: object = None
        self._error: CommandError | None = None

    def result(self, timeout_s: float) -> object:
        """Wait for the reply of the command, a dataclass.

        Raises:
            CommandError: If the command failed, or if there is no reply within `timeout_s`.
        """
        if not self._is_done.wait(timeout_s):
            raise CommandError(
                ErrorCode.TIMED_OUT, f"no answer within {timeout_s:g} s; it may still be done"
            )
        if self._error is not None:
            raise self._error
        return self._reply

    def set_result(self, reply: object) -> None:
        """Set the reply of the command, which has succeeded."""
        self._reply = reply
        self._is_done.set()

    def set_exception(self, error: CommandError) -> None:
        """Set the error of the command, which has failed."""
        self._error = error
        self._is_done.set()


class CommandQueue:
    """A short queue of commands from any thread to the loop."""

    def __init__(self, max_pending: int = MAX_PENDING_COMMANDS) -> None:
        """Make an empty queue.

        Args:
            max_pending: Number of pending commands from which `submit` refuses more.
        """
        self._max_pending = max_pending
        self._pending: deque[CommandFuture] = deque()
        self._lock = threading.Lock()
        self._is_closed = False

    def submit(self, command: Command) -> CommandFuture:
        """Add a command.

        Raises:
            CommandError: `BUSY` if the queue is full; `NOT_POSSIBLE` if the service is ending.
        """
        future = CommandFuture(command)
        with self._lock:
            if self._is_closed:
                raise NotPossibleError("the service is ending")
            if len(self._pending) >= self._max_pending:
                raise CommandError(
                    ErrorCode.BUSY, f"{self._max_pending} commands are waiting already; try again"
                )
            self._pending.append(future)
        return future

    def submit_internal(self, command: Command) -> CommandFuture:
        """Add a command of the program itself; it is accepted even if the queue is full."""
        future = CommandFuture(command)
        with self._lock:
            self._pending.append(future)
        return future

    def take_pending(self) -> list[CommandFuture]:
        """Take all pending commands, the oldest first. Does not block."""
        if not self._pending:
            return []
        with self._lock:
            futures = list(self._pending)
            self._pending.clear()
        return futures

    def close(self) -> None:
        """Refuse all pending and all further commands."""
        with self._lock:
            self._is_closed = True
        for future in self.take_pending():
            future.set_exception(NotPossibleError("the service is ending"))


class Control:
    """Executes commands between two frames; none of them blocks.

    Attributes:
        is_paused: Whether publishing is paused.
    """

    def __init__(
        self,
        odom_frame: OdomFrame,
        camera: RgbdCamera,
        command_queue: CommandQueue | None = None,
        recorder: Recorder | None = None,
        mapper: Mapper | None = None,
    ) -> None:
        """Connect the parts that commands control.

        Args:
            command_queue: Source of the commands; None: there are no commands.
            recorder: Takes recordings and incidents; None: these commands fail.
            mapper: Saves and loads maps; None: these commands fail.
        """
        self._odom_frame = odom_frame
        self._camera = camera
        self._command_queue = command_queue or CommandQueue()
        self._recorder = recorder or NullRecorder()
        self._mapper = mapper or NullMapper()
        self.is_paused = False

    @property
    def recording(self) -> str:
        """Folder of the current recording; "" = none."""
        return self._recorder.recording

    @property
    def map_state(self) -> MapState:
        """The mapper's state."""
        return self._mapper.state

    @property
    def grid(self) -> OccupancyGrid:
        """The mapper's occupancy grid."""
        return self._mapper.grid

    def process_pending(self) -> None:
        """Execute all pending commands, and set their results."""
        for future in self._command_queue.take_pending():
            try:
                future.set_result(self._execute(future.command))
            except CommandError as error:
                future.set_exception(error)
            except CameraError as error:
                future.set_exception(NotPossibleError(str(error)))

    def _execute(self, command: Command) -> object:
        """Execute a command and return its reply."""
        match command:
            case ResetCommand():
                self._odom_frame.reset(command.T_odom_base)
                return EpochReply(self._odom_frame.epoch)
            case PauseCommand() | ResumeCommand():
                self.is_paused = isinstance(command, PauseCommand)
                return PausedReply(self.is_paused)
            case TiltCommand(tilt_deg):
                self._camera.set_tilt_deg(tilt_deg)
                return TiltReply(tilt_deg)
            case LedCommand(led):
                self._camera.set_led(led)
                return LedReply(led)
            case StartRecordingCommand(name):
                return FolderReply(self._recorder.start_recording(name))
            case StopRecordingCommand():
                return FolderReply(self._recorder.stop_recording())
            case SaveIncidentCommand():
                return FolderReply(self._recorder.save("command"))
            case SaveMapCommand(name):
                state = self._mapper.save(name)
                return SavedMapReply(state.saving, state.mesh_keyframes)
            case LoadMapCommand(name):
                return LoadedMapReply(self._mapper.load(name).loading)
            case ReloadConfig():
                command.apply()
                return NoReply()
        raise TypeError(f"no handler for {command}")


# The load is an exponential mean with this time constant. The first frames after a start are not
# counted: kernels are loaded.
TIME_CONSTANT_S, STARTUP_S = 2.0, 3.0
# Upper bound of one frame's load, in frame intervals: one slow frame is not overload.
MAX_FRAME_LOAD = 2.0
# Pause above the first; resume when the load has been below the second for a while.
MAX_LOAD, MAX_LOAD_TO_RESUME = 0.8, 0.6
# Each pause takes at least twice as long as the last one, unless the viewer ran long in between.
MIN_PAUSE_S, MAX_PAUSE_S, LONG_RUN_S = 10.0, 600.0, 60.0
# Time without frames (no camera, a pause) does not count as low load.
MAX_IDLE_S = 1.0


class LoadShedder:
    """Pauses the viewers while the loop has no time left between frames.

    Args:
        viewers: Viewers to pause; without one it does nothing.
        now_s: The clock, s.
    """

    def __init__(
        self, viewers: Sequence[PausableViewer], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._viewers, self._now_s = viewers, now_s
        self._is_enabled, self._is_paused = True, False
        self._load, self._dropped = 0.0, 0
        self._counted_since_s, self._last_s = math.inf, -math.inf
        self._low_since_s, self._resumed_s = math.inf, -math.inf
        self._pause_s = MIN_PAUSE_S

    @property
    def warning(self) -> str:
        """Why the viewer is paused; "" if it is not."""
        return "the machine is too slow: the viewer is paused" if self._is_paused else ""

    @property
    def has_viewers(self) -> bool:
        """Whether there is a viewer to pause."""
        return bool(self._viewers)

    def configure(self, settings: LoadConfig) -> None:
        """Apply new settings; the viewers run again."""
        self._is_enabled = settings.adapt
        self._set_paused(False)

    def add_frame(self, busy_s: float, interval_s: float, dropped: int) -> None:
        """Add the last frame, and pause or resume the viewers if necessary.

        Args:
            busy_s: Time from its arrival in the loop to the end of its processing, s.
            interval_s: The camera's frame interval, s; 0 while unknown.
            dropped: Number of frames dropped since the start because the loop was late.
        """
        has_dropped, self._dropped = dropped > self._dropped, dropped
        if not (self._is_enabled and self._viewers and interval_s > 0.0):
            return
        now_s = self._now_s()
        if now_s - busy_s - self._last_s > MAX_IDLE_S:
            self._counted_since_s, self._low_since_s = now_s + STARTUP_S, math.inf
        self._last_s = now_s
        if now_s < self._counted_since_s:
            return
        share = min(busy_s / interval_s, MAX_FRAME_LOAD)
        share = max(share, 1.0) if has_dropped else share
        self._load += min(1.0, interval_s / TIME_CONSTANT_S) * (share - self._load)
        if self._load > MAX_LOAD:
            self._pause(now_s)
        elif self._is_paused:
            self._resume_if_due(now_s)

    def _pause(self, now_s: float) -> None:
        self._low_since_s = math.inf
        if not self._is_paused:
            had_long_run = now_s - self._resumed_s > LONG_RUN_S
            self._pause_s = MIN_PAUSE_S if had_long_run else min(2 * self._pause_s, MAX_PAUSE_S)
            self._set_paused(True)
            logger.warning("%s", self.warning)

    def _resume_if_due(self, now_s: float) -> None:
        if self._load >= MAX_LOAD_TO_RESUME:
            self._low_since_s = math.inf
            return
        self._low_since_s = min(self._low_since_s, now_s)
        if now_s - self._low_since_s >= self._pause_s:
            self._resumed_s = now_s
            self._set_paused(False)
            logger.warning("the load is low again: the viewer draws")

    def _set_paused(self, is_paused: bool) -> None:
        self._is_paused, self._low_since_s = is_paused, math.inf
        for viewer in self._viewers:
            viewer.set_paused(is_paused)
