"""The pictures of one process: a scene, and when its place is full, the next. Imports rerun."""

import time
from dataclasses import replace

import rerun as rr

from drivers.core.errors import UserFacingError
from vo_service.outputs.rerun.blueprint import make_blueprint
from vo_service.outputs.rerun.messages import (
    FrameScalars,
    GroundTruth,
    InitialState,
    MapGraph,
    RerunMessage,
    RerunWorkerConfig,
    TrajectoryPoint,
)
from vo_service.outputs.rerun.scene import RerunScene
from vo_service.outputs.rerun.sinks import APPLICATION, DiskFullError, Sink

CHECK_PERIOD_S = RETRY_PERIOD_S = 1.0


class RotatingRecording:
    """Draws what it is told. A file that is full is followed by the next, which has all it needs.

    trouble     what is wrong now, "" while all is well
    incomplete  what could not be kept, "" if everything was
    """

    def __init__(self, config: RerunWorkerConfig) -> None:
        """Open the place. Raises UserFacingError if that cannot be."""
        # Rerun waits at exit until everything is sent, for ever if the viewer is frozen.
        rr.unregister_shutdown()
        self._config = config
        self._sink = config.sink
        # One for all files: Rerun never gives back the memory of a stream, 3 MB each.
        self._stream = rr.RecordingStream(APPLICATION, recording_id=config.recording_id)
        self._initial_state = InitialState()
        self._scene: RerunScene | _NullScene = _NullScene()
        self._abandoned_scene: RerunScene | _NullScene = self._scene
        self._last_check_s = time.monotonic()
        self.fault = self.data_loss = ""
        try:
            self._start_scene()
        except DiskFullError as error:
            self._suspend(error)

    def log(self, message: RerunMessage) -> None:
        """Show one message, and see to it that the next can be shown."""
        match message:
            case InitialState():
                self._initial_state = message
            case GroundTruth():
                self._initial_state = replace(self._initial_state, ground_truth=message)
            case MapGraph():
                self._initial_state = replace(self._initial_state, graph=message)
            case TrajectoryPoint(position, epoch):
                if not self._initial_state.trajectory.add(position, epoch):
                    return
            case FrameScalars():
                self._check_and_rotate()
        self._scene.log(message)

    def finish(self) -> None:
        """Write out everything."""
        try:
            self._scene.check_written(self._sink)
        except DiskFullError as error:
            self._suspend(error)
        except UserFacingError as error:
            self._stop(error)
        self._scene.finish()
        self._sink.close()

    def _start_scene(self) -> None:
        self._sink.attach(self._stream, make_blueprint())
        self._scene = RerunScene(self._stream, self._initial_state, self._config.jpeg_quality)
        self.fault = ""

    def _check_and_rotate(self) -> None:
        """Before something new is drawn."""
        try:
            if time.monotonic() - self._last_check_s > CHECK_PERIOD_S:
                self._last_check_s = time.monotonic()
                self._scene.check_written(self._sink)
            if self._scene.should_rotate(self._sink):
                self._scene.finish()
                self._start_scene()
        except DiskFullError as error:
            self._suspend(error)
        except UserFacingError as error:
            self._stop(error)

    def _suspend(self, error: UserFacingError) -> None:
        """Show nothing until it may be tried again."""
        self._scene.finish()
        self._disable(error, time.monotonic() + RETRY_PERIOD_S)

    def _stop(self, error: UserFacingError) -> None:
        """Show nothing any more. The scene is left as it is: to end it could take for ever."""
        self._abandoned_scene = self._scene
        self._disable(error, float("inf"))

    def _disable(self, error: UserFacingError, retry_s: float) -> None:
        self._scene = _NullScene(retry_s)
        self.fault = str(error)
        self.data_loss = self.data_loss or self.fault


class _NullScene:
    """No scene: nothing is shown until `retry_s`."""

    def __init__(self, retry_s: float = 0.0) -> None:
        self._retry_s = retry_s

    def log(self, message: RerunMessage) -> None:
        """Nowhere."""

    def check_written(self, sink: Sink) -> None:
        """Nothing was logged."""

    def should_rotate(self, sink: Sink) -> bool:
        """Whether it is time to try again."""
        return time.monotonic() >= self._retry_s

    def finish(self) -> None:
        """Nothing to write."""
