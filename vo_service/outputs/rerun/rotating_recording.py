"""Recording of one process: one scene after another, a new one for each full file."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
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
from vo_service.outputs.rerun.sinks import APPLICATION, BrokenFileError, ViewerGoneError
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
        self._last_check_s = time.monotonic()
        try:
            self._start_scene()
        except WriteError as error:
            if not is_disk_full(error):
                raise
            self._fault.set(error, can_retry=True)

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
        if not self._fault:
            self._scene.log(message)

    def finish(self) -> None:
        """Flush everything and close the sink."""
        try:
            with self._setting_fault():
                if not self._fault:
                    self._sink.check(self._stream)
        except ViewerGoneError:
            return  # nothing is stored, and closing the stream could block
        if not self._fault:
            self._stream.disconnect()
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
        with self._setting_fault():
            if self._fault:
                if self._fault.is_retry_due:
                    self._start_scene()
                return
            is_full = self._sink.is_full()
            if is_full or time.monotonic() - self._last_check_s > CHECK_PERIOD_S:
                self._last_check_s = time.monotonic()
                self._sink.check(self._stream)
            if is_full:
                self._stream.disconnect()
                self._start_scene()

    @contextmanager
    def _setting_fault(self) -> Iterator[None]:
        """Draw nothing from an error of the sink on, until the next retry if that can help.

        Raises:
            ViewerGoneError: The viewer does not read.
        """
        try:
            yield
        except ViewerGoneError:
            raise
        except BrokenFileError as error:
            self._fault.set(error, can_retry=False)  # closing the stream could block forever
        except UserFacingError as error:
            if not self._fault:
                self._stream.disconnect()
            self._fault.set(error, can_retry=True)
