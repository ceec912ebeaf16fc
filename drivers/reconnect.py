"""The one place that opens a lost camera again."""

import math
import time
from collections.abc import Callable
from enum import StrEnum

from drivers.camera import CameraState, CameraStatus, FrameTimeout, RgbdCamera, RgbdFrame
from drivers.camera_wrapper import CameraWrapper
from drivers.core import CameraError, CameraLostError, CameraNotFoundError
from drivers.core.rate_limits import ExponentialBackoff

INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 1.5


class ConnectionPhase(StrEnum):
    """What happens with a camera; the call of a native library may hang in each."""

    OPENING = "opening the camera"
    STARTING = "waiting for the first frame"
    STREAMING = "reading frames"
    CLOSING = "closing the camera"
    WAITING = "waiting to open the camera again"


class ReconnectingCamera(CameraWrapper):
    """A camera that is opened again whenever it is lost.

    `open` tries it once; `read` tries it again when that is due, and times out while the camera is
    lost. `status` has the reason. It does not alternate while the camera fails repeatedly: the last
    one stays until the camera delivers. Errors that waiting does not help (InputError) are raised
    by `read`.

    Args:
        first_frame_s: Longest time from its `open` to the first frame.
        backoff: Delays between two attempts to open it.
        on_phase: Called before each call that may take long, and when the camera delivers.

    Attributes:
        loss: Why the camera is lost; None while it is not.
        phase: What happens with the camera.
    """

    def __init__(
        self,
        camera: RgbdCamera,
        status: CameraStatus = CameraStatus(CameraState.OPENING),  # noqa: B008 (frozen)
        first_frame_s: float = math.inf,
        backoff: ExponentialBackoff | None = None,
        on_phase: Callable[[ConnectionPhase], None] = lambda phase: None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(camera)
        self.reconnects = True
        self.loss: CameraError | None = None
        self._first_frame_s, self._on_phase = first_frame_s, on_phase
        self._now_s = now_s
        self._backoff = backoff or ExponentialBackoff(INITIAL_RETRY_S, MAX_RETRY_S)
        self._status, self.phase = status, ConnectionPhase.CLOSING
        self._is_open = False
        self._retry_due_s, self._waited_s = 0.0, 0.0

    def open(self) -> None:
        """Open the camera if it is there. Raises InputError, but no CameraError."""
        try:
            self._open()
        except CameraError as error:
            self._lose(error)

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera.read` and the class."""
        begin_s = self._now_s()
        try:
            if not self._is_open:
                self._wait_until_due(timeout_s)
                self._open()
            frame = self._camera.read(max(0.0, begin_s + timeout_s - self._now_s()))
        except FrameTimeout:
            self._waited_s += self._now_s() - begin_s
            self._check_first_frame()
            raise
        except CameraError as error:
            self._lose(error)
            raise FrameTimeout from error
        if self.phase is ConnectionPhase.STARTING:
            self._backoff.reset()
            self.loss, self._status = None, CameraStatus(CameraState.STREAMING)
            self._enter(ConnectionPhase.STREAMING)
        return frame

    def close(self) -> None:
        self._is_open = False
        self._enter(ConnectionPhase.CLOSING)
        self._camera.close()

    @property
    def status(self) -> CameraStatus:
        """Status of the camera while it delivers, or why it does not."""
        if self.phase is ConnectionPhase.STREAMING:
            return self._camera.status
        if self.phase is not ConnectionPhase.STARTING or self._status.state is CameraState.LOST:
            return self._status
        status = self._camera.status
        is_streaming = status.state is CameraState.STREAMING  # the status of most cameras
        return CameraStatus(CameraState.STARTING) if is_streaming else status

    def _wait_until_due(self, timeout_s: float) -> None:
        """Wait until the camera is to be opened. Raises FrameTimeout after `timeout_s`."""
        begin_s = self._now_s()
        wait_s = self._retry_due_s - begin_s
        if wait_s > 0.0:
            self._enter(ConnectionPhase.WAITING)
            self._camera.wait_for_reconnect(min(wait_s, timeout_s))
            has_device = self._now_s() - begin_s < min(wait_s, timeout_s)
            if wait_s > timeout_s and not has_device:
                raise FrameTimeout

    def _open(self) -> None:
        self._enter(ConnectionPhase.OPENING)
        self._camera.open()
        self._is_open, self._waited_s = True, 0.0
        self._enter(ConnectionPhase.STARTING)

    def _check_first_frame(self) -> None:
        """Close the camera if it sends no first frame in time."""
        if self.phase is ConnectionPhase.STARTING and self._waited_s > self._first_frame_s:
            text = (
                f"{self.name}: open, but sent no frame within {self._first_frame_s:g} s; "
                "it is opened again"
            )
            self._lose(CameraLostError(self._camera.status.reason or text))

    def _lose(self, error: CameraError) -> None:
        """Close the camera, and open it again later."""
        state = CameraState.OPENING if self.phase is ConnectionPhase.OPENING else CameraState.LOST
        if isinstance(error, CameraNotFoundError):
            state = CameraState.ABSENT
        self.loss, self._status = error, CameraStatus(state, str(error))
        self.close()
        self._retry_due_s = self._now_s() + self._backoff.next_s()

    def _enter(self, phase: ConnectionPhase) -> None:
        self.phase = phase
        self._on_phase(phase)
