"""The pictures of one process: a scene, and when its place is full, the next. Imports rerun."""

import time
from dataclasses import replace

import rerun as rr

from drivers.errors import UserFacingError
from vo_service.viewer.blueprint import blueprint
from vo_service.viewer.messages import Backdrop, Graph, Job, Message, Numbers, Point, Truth
from vo_service.viewer.scene import Scene
from vo_service.viewer.sinks import APPLICATION, DiskFullError, Sink

CHECK_PERIOD_S = RETRY_PERIOD_S = 1.0


class Drawing:
    """Draws what it is told. A file that is full is followed by the next, which has all it needs.

    trouble     what is wrong now, "" while all is well
    incomplete  what could not be kept, "" if everything was
    """

    def __init__(self, job: Job) -> None:
        """Open the place. Raises UserFacingError if that cannot be."""
        # Rerun waits at exit until everything is sent, for ever if the viewer is frozen.
        rr.unregister_shutdown()
        self._job = job
        self._sink = job.sink
        # One for all files: Rerun never gives back the memory of a stream, 3 MB each.
        self._stream = rr.RecordingStream(APPLICATION, recording_id=job.recording_id)
        self._backdrop = Backdrop()
        self._scene: Scene | _Blank = _Blank()
        self._abandoned: Scene | _Blank = self._scene
        self._checked_s = time.monotonic()
        self.trouble = self.incomplete = ""
        try:
            self._begin()
        except DiskFullError as error:
            self._give_up(error)

    def draw(self, message: Message) -> None:
        """Show one message, and see to it that the next can be shown."""
        match message:
            case Backdrop():
                self._backdrop = message
            case Truth():
                self._backdrop = replace(self._backdrop, truth=message)
            case Graph():
                self._backdrop = replace(self._backdrop, graph=message)
            case Point(position, epoch):
                if not self._backdrop.trail.add(position, epoch):
                    return
            case Numbers():
                self._look_after()
        self._scene.draw(message)

    def finish(self) -> None:
        """Write out everything."""
        try:
            self._scene.check(self._sink)
        except DiskFullError as error:
            self._give_up(error)
        except UserFacingError as error:
            self._abandon(error)
        self._scene.finish()
        self._sink.close()

    def _begin(self) -> None:
        self._sink.attach(self._stream, blueprint())
        self._scene = Scene(self._stream, self._backdrop, self._job.jpeg_quality)
        self.trouble = ""

    def _look_after(self) -> None:
        """Before something new is drawn."""
        try:
            if time.monotonic() - self._checked_s > CHECK_PERIOD_S:
                self._checked_s = time.monotonic()
                self._scene.check(self._sink)
            if self._scene.is_over(self._sink):
                self._scene.finish()
                self._begin()
        except DiskFullError as error:
            self._give_up(error)
        except UserFacingError as error:
            self._abandon(error)

    def _give_up(self, error: UserFacingError) -> None:
        """Show nothing until it may be tried again."""
        self._scene.finish()
        self._blank(error, time.monotonic() + RETRY_PERIOD_S)

    def _abandon(self, error: UserFacingError) -> None:
        """Show nothing any more. The scene is left as it is: to end it could take for ever."""
        self._abandoned = self._scene
        self._blank(error, float("inf"))

    def _blank(self, error: UserFacingError, retry_s: float) -> None:
        self._scene = _Blank(retry_s)
        self.trouble = str(error)
        self.incomplete = self.incomplete or self.trouble


class _Blank:
    """No scene: nothing is shown until `retry_s`."""

    def __init__(self, retry_s: float = 0.0) -> None:
        self._retry_s = retry_s

    def draw(self, message: Message) -> None:
        """Nowhere."""

    def check(self, sink: Sink) -> None:
        """Nothing was logged."""

    def is_over(self, sink: Sink) -> bool:
        """Whether it is time to try again."""
        return time.monotonic() >= self._retry_s

    def finish(self) -> None:
        """Nothing to write."""
