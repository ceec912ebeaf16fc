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
from drivers.core.flow_control import ExponentialBackoff
from drivers.core.geometry import Trajectory
from drivers.core.process.client import WorkerClient
from drivers.core.process.messages import WorkerFailed
from drivers.core.process.worker_spec import WorkerSpec
from drivers.reconnect import ConnectionPhase
from drivers.subprocess_camera.frame_ring import FrameRingEndedError, FrameRingReader
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    CameraWorkerMessage,
    DeviceRequest,
    SetLed,
    SetTilt,
    Timeouts,
)
from drivers.subprocess_camera.sequencing import make_sequencer

_log = logging.getLogger(__name__)

CAMERA_WORKER = WorkerSpec("drivers.subprocess_camera.worker:run_camera", "driver")
_OPEN_PHASES = (ConnectionPhase.STARTING, ConnectionPhase.STREAMING)


class CameraWorkerClient:
    """Runs the worker process of a camera, even while nobody reads frames.

    Status, properties and counters may be read at any time from any thread.

    Args:
        factory: Makes the camera.
        playback_mode: Whether the worker waits for a late reader.
        is_live: Whether the process is restarted; the end of a recording's process is an error.
        timeouts: Time limits.
        ring: Receives the frames; it must be open from before `start` until after `stop`.

    Attributes:
        status: Status of the camera, or of its process.
        camera_properties: Properties of the camera.
        final_exception: Why no frame will follow; None while frames may follow.
    """

    def __init__(
        self,
        factory: CameraFactory,
        playback_mode: PlaybackMode,
        is_live: bool,
        timeouts: Timeouts,
        ring: FrameRingReader,
    ) -> None:
        self._factory, self._playback_mode, self._is_live = factory, playback_mode, is_live
        self._timeouts, self._ring = timeouts, ring
        self._spec = replace(
            CAMERA_WORKER,
            start_timeout_s=timeouts.launching_s,
            exit_timeout_s=timeouts.closing_s,
            orphan_timeout_s=timeouts.orphan_s,
        )
        self._supervisor: WorkerClient | None = None
        # The last request of each type, for every new process.
        self._requests: dict[type[DeviceRequest], DeviceRequest] = {}
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._reset()

    def start(self) -> None:
        """Start the worker process."""
        self._reset()
        self._supervisor = WorkerClient(
            self._spec,
            self._make_config,
            self._handle_message,
            self._handle_exit,
            ExponentialBackoff(self._timeouts.initial_retry_s, self._timeouts.max_retry_s),
        )

    def wait_until_open(self) -> None:
        """Wait until the camera is open for the first time. Raises the error that prevents it."""
        self._is_settled.wait()
        if self.final_exception is not None and not self._was_open:
            raise self.final_exception

    def stop(self) -> None:
        """End the process in order if possible, otherwise by force. Safe to call at any time."""
        if self._supervisor is not None:
            has_camera = self._phase not in (None, ConnectionPhase.WAITING)
            self._supervisor.close(None if has_camera else 0.0)

    def send_request(self, request: DeviceRequest) -> bool:
        """Send a request without waiting; return False if the camera is not open now.

        The request is applied again whenever the camera is opened.
        """
        self._requests[type(request)] = request
        is_sent = self._supervisor is not None and self._supervisor.send(request)
        return is_sent and self._phase in _OPEN_PHASES

    @property
    def counters(self) -> CameraCounters:
        """The camera's totals over all processes."""
        earlier, current = self._counted
        return earlier + current

    def _reset(self) -> None:
        self.status = CameraStatus(CameraState.OPENING)
        self.camera_properties, self._was_open = CameraProperties(), False
        self.final_exception: Exception | None = None
        self._phase: ConnectionPhase | None = None  # None = the process is starting up
        self._is_settled = threading.Event()

    def _make_config(self) -> CameraWorkerConfig:
        self._phase, self._counted = None, (self.counters, CameraCounters())
        if self._is_live:
            self._ring.allow_writes()
        return CameraWorkerConfig(
            self._factory,
            self._playback_mode,
            self._is_live,
            self._timeouts,
            self._ring.fds,
            self.status,
            tuple(self._requests.values()),
        )

    def _handle_message(self, message: CameraWorkerMessage) -> None:
        match message:
            case CameraHeartbeat(phase, status, counters):
                self._phase, self.status = phase, status
                self._counted = self._counted[0], counters
                if phase is ConnectionPhase.STREAMING and self._supervisor is not None:
                    self._supervisor.backoff.reset()
            case CameraProperties():
                self.camera_properties, self._was_open = message, True
                self._is_settled.set()
            case CameraFinished():
                self._finish(EndOfStream())
            case WorkerFailed(error):
                self._finish(error)

    def _handle_exit(self, reason: str) -> bool:
        """Report the end of a process; return whether another is to be started."""
        if self.final_exception is not None:
            return False
        text = f"the driver {reason}"
        _log.info("%s", text)
        if not self._is_live:
            self._finish(CameraLostError(f"{text}; open the recording again"))
            return False
        self._ring.reset()
        was_open = self._phase in (*_OPEN_PHASES, ConnectionPhase.CLOSING)
        self.status = CameraStatus(CameraState.LOST if was_open else CameraState.OPENING, text)
        return True

    def _finish(self, exception: Exception) -> None:
        """End the stream after the frames in the ring."""
        self.final_exception = exception
        self._ring.finish()
        self._is_settled.set()


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

    Args:
        name: Name for messages.
        clock: Clock of the stamps; monotonic for a live camera.
        factory: Makes the camera in the worker process; a module's class or function, or a partial.
        playback_mode: Lockstep or realtime.
        timeouts: Time limits of the worker process.
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
        self._ring = FrameRingReader(playback_mode)
        self._client = CameraWorkerClient(
            factory, playback_mode, self.reconnects, timeouts, self._ring
        )
        self._sequencer = make_sequencer(clock, playback_mode)
        self._delivered = self._skipped = 0

    def open(self) -> None:
        """Start the worker process; see the class."""
        self.close()
        try:
            self._ring.open()
            self._client.start()
            if not self.reconnects:
                self._client.wait_until_open()
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
        """End the process. Properties and counters remain valid."""
        try:
            self._client.stop()
        finally:
            self._ring.close()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; up to 0.3 s old."""
        own = CameraCounters(dropped=self._ring.dropped, skipped=self._skipped)
        return replace(self._client.counters + own, delivered=self._delivered)

    @property
    def status(self) -> CameraStatus:
        """The status of the camera, or of its process."""
        return self._client.status

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" until the camera has been open."""
        return self._client.camera_properties.intrinsics_source

    @property
    def frame_count(self) -> int | None:
        """The camera's number of frames; None until it has been open."""
        return self._client.camera_properties.frame_count

    @property
    def has_motor(self) -> bool:
        """Whether the camera has a motor and an LED; True until it has been open."""
        return self._client.camera_properties.has_motor

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Request a tilt, see `RgbdCamera.set_tilt_deg`. A missing motor is logged later."""
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._request(SetTilt(tilt_deg))

    def set_led(self, led: Led) -> None:
        """Request a state of the LED, as `set_tilt_deg` does."""
        if not self.has_motor:
            super().set_led(led)
        self._request(SetLed(led))

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses from the camera; None until it has been open."""
        return self._client.camera_properties.ground_truth

    def _request(self, request: DeviceRequest) -> None:
        """Send a request. Raises CameraError if the camera is not open now."""
        if not self._client.send_request(request):
            raise CameraError(
                f"{self.name}: not open now ({self.status}); the setting is applied when it opens"
            )

    def _get_frame(self, timeout_s: float) -> RgbdFrame:
        try:
            return self._ring.get(timeout_s)
        except FrameRingEndedError:
            raise self._client.final_exception or CameraLostError(
                f"{self.name}: not open; use `with`, or call open()"
            ) from None
