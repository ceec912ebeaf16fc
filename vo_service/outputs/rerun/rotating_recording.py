"""Recording of one process: one scene after another, a new one for each full file."""

import time
from dataclasses import replace

import rerun as rr

from drivers.core import UserFacingError
from drivers.core.write_errors import WriteError, is_disk_full
from vo_service.outputs.rerun.blueprint import make_blueprint
from vo_service.outputs.rerun.messages import (
    FrameScalars,
    GridCells,
    GroundTruth,
    InitialState,
    MapGraph,
    RerunMessage,
    RerunWorkerConfig,
    TrajectoryPoint,
)
from vo_service.outputs.rerun.scene import RerunScene
from vo_service.outputs.rerun.sinks import APPLICATION, BrokenFileError, Sink, ViewerGoneError
from vo_service.outputs.write_fault import WriteFault

CHECK_PERIOD_S = 1.0


class RotatingRecording:
    """Draws messages into a sink. A full file is followed by a new, self-contained one.

    Imports rerun: only for the viewer's process.
    """

    def __init__(self, config: RerunWorkerConfig) -> None:
        """Open the sink. A full disk is only a fault: there may be space later.

        Raises:
            UserFacingError: If that fails.
        """
        # At exit, Rerun waits until everything is sent: forever if the viewer is frozen.
        rr.unregister_shutdown()
        self._config = config
        self._sink = config.sink
        # One stream for all files: Rerun never frees the memory of a stream, 3 MB each.
        self._stream = rr.RecordingStream(APPLICATION, recording_id=config.recording_id)
        self._initial_state = InitialState()
        self._fault = WriteFault()
        self._scene: RerunScene | _NullScene = _NullScene(self._fault)
        self._abandoned_scene: RerunScene | _NullScene = self._scene
        self._last_check_s = time.monotonic()
        try:
            self._start_scene()
        except WriteError as error:
            if not is_disk_full(error):
                raise
            self._suspend(error)

    def log(self, message: RerunMessage) -> None:
        """Draw one message; before a new frame, check the file and rotate it if it is full.

        Raises:
            ViewerGoneError: The viewer does not read.
        """
        match message:
            case InitialState():
                self._initial_state = message
            case GroundTruth():
                self._initial_state = replace(self._initial_state, ground_truth=message)
            case MapGraph():
                self._initial_state = replace(self._initial_state, graph=message)
            case GridCells():
                self._initial_state = replace(self._initial_state, grid=message)
            case TrajectoryPoint(position, epoch):
                if not self._initial_state.trajectory.add(position, epoch):
                    return
            case FrameScalars():
                self.check()
        self._scene.log(message)

    def finish(self) -> None:
        """Flush everything and close the sink."""
        try:
            self._scene.check_written(self._sink)
        except ViewerGoneError:
            return  # nothing is stored, and closing the stream could block
        except BrokenFileError as error:
            self._stop(error)
        except UserFacingError as error:
            self._suspend(error)
        self._scene.finish()
        self._sink.close()

    def _start_scene(self) -> None:
        self._sink.attach(self._stream, make_blueprint())
        self._scene = RerunScene(self._stream, self._initial_state, self._config.jpeg_quality)
        self._fault.clear()

    @property
    def fault(self) -> str:
        """The current fault, "" if there is none."""
        return str(self._fault)

    @property
    def data_loss(self) -> str:
        """Why data was lost, "" if none was."""
        return str(self._fault.data_loss or "")

    def check(self) -> None:
        """Check now and then that data arrives; start a new scene if the file is full.

        Raises:
            ViewerGoneError: The viewer does not read.
        """
        try:
            if time.monotonic() - self._last_check_s > CHECK_PERIOD_S:
                self._last_check_s = time.monotonic()
                self._scene.check_written(self._sink)
            if self._scene.should_rotate(self._sink):
                self._scene.check_written(self._sink)
                self._scene.finish()
                self._start_scene()
        except ViewerGoneError:
            raise
        except BrokenFileError as error:
            self._stop(error)
        except UserFacingError as error:
            self._suspend(error)

    def _suspend(self, error: UserFacingError) -> None:
        """Draw nothing until the next retry."""
        self._scene.finish()
        self._disable(error, can_retry=True)

    def _stop(self, error: UserFacingError) -> None:
        """Draw nothing any more. The scene is not finished, as that could block forever."""
        self._abandoned_scene = self._scene
        self._disable(error, can_retry=False)

    def _disable(self, error: UserFacingError, *, can_retry: bool) -> None:
        self._fault.set(error, can_retry=can_retry)
        self._scene = _NullScene(self._fault)


class _NullScene:
    """Scene that draws nothing until a retry is due."""

    def __init__(self, fault: WriteFault) -> None:
        self._fault = fault

    def log(self, message: RerunMessage) -> None:
        """Ignore the message."""

    def check_written(self, sink: Sink) -> None:
        """Do nothing."""

    def should_rotate(self, sink: Sink) -> bool:
        """Return whether a retry is due."""
        return self._fault.is_retry_due

    def finish(self) -> None:
        """Do nothing."""
