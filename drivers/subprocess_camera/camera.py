"""Any camera in a process of its own, which is restarted if a native library hangs or crashes."""

import logging
import threading
import time
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraFactory,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    Led,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraError, CameraLostError
from drivers.core.geometry import Trajectory
from drivers.core.process.messages import WorkerFailed
from drivers.core.process.worker_client import WorkerClient
from drivers.core.process.worker_spec import WorkerSpec
from drivers.core.rate_limits import ExponentialBackoff
from drivers.reconnect import ConnectionPhase
from drivers.subprocess_camera.frame_ring import FrameRingEndedError, FrameRingReader
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    CameraWorkerMessage,
    DeviceRequest,
    Timeouts,
)
from drivers.subprocess_camera.sequencing import make_sequencer

_log = logging.getLogger(__name__)

CAMERA_WORKER = WorkerSpec("drivers.subprocess_camera.worker:run_camera", "driver")
_OPEN_PHASES = (ConnectionPhase.STARTING, ConnectionPhase.STREAMING)


class SubprocessCamera(RgbdCamera):
    """A camera in a process of its own; frames pass through shared memory.

    A live camera (`clock` is monotonic) is opened again after each loss: `open` returns at once,
    `read` times out while the camera is lost, and `status` gives the reason. `seq` and stamps rise
    across all of these, and across `close` and `open`.

    A recording is opened by `open` and starts with the first `read`. It is never restarted: if its
    process dies, `read` raises CameraLostError.

    In lockstep the camera waits for a late reader; in realtime the reader gets the newest frame.

    A permanent error (InputError, a library that is not installed) is raised by `open` of a
    recording, and by `read` of a live camera.

    Its process has the same `WorkerClient` as that of an output (`vo_service.process_output`), and
    nothing else of it: frames come from the process, so there is no queue and no thread to send
    them, and a request that comes too early is stored instead of refused.

    Args:
        clock: Clock of the stamps; monotonic for a live camera.
        factory: Makes the camera in the worker process; a module's class or function, or a partial.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        factory: CameraFactory,
        playback_mode: PlaybackMode,
        timeouts: Timeouts = Timeouts(),  # noqa: B008 (frozen)
    ) -> None:
        self.name, self.clock = name, clock
        self.reconnects = clock is Clock.MONOTONIC
        self._factory, self._playback_mode, self._timeouts = factory, playback_mode, timeouts
        self._ring = FrameRingReader(playback_mode)
        self._sequencer = make_sequencer(clock, playback_mode)
        self._delivered = self._skipped = 0
        self._client: WorkerClient | None = None
        # The last request of each setter, for every new process.
        self._requests: dict[str, DeviceRequest] = {}
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._reset()

    def open(self) -> None:
        """Start the worker process; see the class."""
        self.close()
        try:
            self._ring.open()
            self._reset()
            self._start_client()
            if not self.reconnects:
                self._wait_until_open()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame, see `RgbdCamera.read`. Raises also permanent errors."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = self._sequencer(self._get_frame(max(0.0, deadline_s - time.monotonic())))
            if frame is not None:
                self._delivered += 1
                return frame
            self._skipped += 1

    def close(self) -> None:
        """End the process, by force if needed. Properties and counters remain valid."""
        try:
            if self._client is not None:
                has_camera = self._phase not in (None, ConnectionPhase.WAITING)
                self._client.close(None if has_camera else 0.0)
        finally:
            self._ring.close()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; up to 0.3 s old."""
        earlier, current = self._counted
        own = CameraCounters(dropped=self._ring.dropped, skipped=self._skipped)
        return replace(earlier + current + own, delivered=self._delivered)

    @property
    def status(self) -> CameraStatus:
        """The status of the camera, or of its process."""
        return self._status

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" until the camera has been open."""
        return self._properties.intrinsics_source

    @property
    def frame_count(self) -> int | None:
        """The camera's number of frames; None until it has been open."""
        return self._properties.frame_count

    @property
    def has_motor(self) -> bool:
        """Whether the camera has a motor and an LED; True until it has been open."""
        return self._properties.has_motor

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses from the camera; None until it has been open."""
        return self._properties.ground_truth

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Request a tilt, see `RgbdCamera.set_tilt_deg`. A missing motor is logged later."""
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._request(DeviceRequest("set_tilt_deg", tilt_deg))

    def set_led(self, led: Led) -> None:
        """Request a state of the LED, as `set_tilt_deg` does."""
        if not self.has_motor:
            super().set_led(led)
        self._request(DeviceRequest("set_led", led))

    def _request(self, request: DeviceRequest) -> None:
        """Send a request; it is applied again whenever the camera is opened.

        Raises:
            CameraError: The camera is not open now.
        """
        self._requests[request.setter] = request
        is_sent = self._client is not None and self._client.send(request)
        if not (is_sent and self._phase in _OPEN_PHASES):
            raise CameraError(
                f"{self.name}: not open now ({self.status}); the setting is applied when it opens"
            )

    def _get_frame(self, timeout_s: float) -> RgbdFrame:
        try:
            return self._ring.get(timeout_s)
        except FrameRingEndedError:
            raise self._final_exception or CameraLostError(
                f"{self.name}: not open; use `with`, or call open()"
            ) from None

    def _reset(self) -> None:
        self._status = CameraStatus(CameraState.OPENING)
        self._properties, self._was_open = CameraProperties(), False
        self._final_exception: Exception | None = None  # why no frame will follow
        self._phase: ConnectionPhase | None = None  # None = the process is starting up
        self._is_settled = threading.Event()

    def _start_client(self) -> None:
        timeouts = self._timeouts
        spec = replace(
            CAMERA_WORKER,
            start_timeout_s=timeouts.launching_s,
            exit_timeout_s=timeouts.closing_s,
            orphan_timeout_s=timeouts.orphan_s,
        )
        self._client = WorkerClient(
            spec,
            self._make_config,
            self._handle_message,
            self._handle_exit,
            ExponentialBackoff(timeouts.initial_retry_s, timeouts.max_retry_s),
        )

    def _wait_until_open(self) -> None:
        """Wait until the camera is open for the first time. Raises the error that prevents it."""
        self._is_settled.wait()
        if self._final_exception is not None and not self._was_open:
            raise self._final_exception

    # The client's thread calls what follows.

    def _make_config(self) -> CameraWorkerConfig:
        earlier, current = self._counted
        self._phase, self._counted = None, (earlier + current, CameraCounters())
        if self.reconnects:
            self._ring.allow_writes()
        return CameraWorkerConfig(
            self._factory,
            self._playback_mode,
            self.reconnects,
            self._timeouts,
            self._ring.fds,
            self.status,
            tuple(self._requests.values()),
        )

    def _handle_message(self, message: CameraWorkerMessage) -> None:
        match message:
            case CameraHeartbeat(phase, status, counters):
                self._phase, self._status = phase, status
                self._counted = self._counted[0], counters
                if phase is ConnectionPhase.STREAMING and self._client is not None:
                    self._client.backoff.reset()
            case CameraProperties():
                self._properties, self._was_open = message, True
                self._is_settled.set()
            case CameraFinished():
                self._finish(EndOfStream())
            case WorkerFailed(error):
                self._finish(error)

    def _handle_exit(self, reason: str) -> bool:
        """Report the end of a process; return whether another is to be started."""
        if self._final_exception is not None:
            return False
        text = f"the driver {reason}"
        _log.info("%s", text)
        if not self.reconnects:
            self._finish(CameraLostError(f"{text}; open the recording again"))
            return False
        self._ring.reset()
        was_open = self._phase in (*_OPEN_PHASES, ConnectionPhase.CLOSING)
        self._status = CameraStatus(CameraState.LOST if was_open else CameraState.OPENING, text)
        return True

    def _finish(self, exception: Exception) -> None:
        """End the stream after the frames in the ring."""
        self._final_exception = exception
        self._ring.finish()
        self._is_settled.set()
