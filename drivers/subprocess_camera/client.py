"""The service's side of a camera's worker process: its status, counters and settings."""

import logging
import threading
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraFactory,
    CameraState,
    CameraStatus,
    EndOfStream,
    PlaybackMode,
)
from drivers.core.errors import CameraLostError
from drivers.core.process.messages import WorkerFailed
from drivers.core.process.supervisor import ExponentialBackoff, WorkerSupervisor
from drivers.core.process.worker_process import WorkerSpec
from drivers.reconnect import ConnectionPhase
from drivers.subprocess_camera.frame_ring import FrameRingReader
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    CameraWorkerMessage,
    DeviceRequest,
    Timeouts,
)

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
        self._supervisor: WorkerSupervisor | None = None
        # The last request of each type, for every new process.
        self._requests: dict[type[DeviceRequest], DeviceRequest] = {}
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._reset()

    def start(self) -> None:
        """Start the worker process."""
        self._reset()
        self._supervisor = WorkerSupervisor(
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
