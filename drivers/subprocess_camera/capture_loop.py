"""The loop of the worker process: open the camera, pass its frames on, open it again."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
)
from drivers.core.errors import CameraError, CameraLostError, CameraNotFoundError
from drivers.core.process.supervisor import ExponentialBackoff
from drivers.subprocess_camera.frame_ring import FrameRingWriter
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerMessage,
    StartCameraWorker,
    WorkerPhase,
)

POLL_S = 0.25


class CaptureLoop:
    """Reads a camera until it is stopped, a recording ends, or a permanent error occurs.

    The status does not alternate between "opening" and "absent" while a camera fails repeatedly:
    the last one stays until the camera delivers.
    """

    def __init__(
        self,
        camera: RgbdCamera,
        ring: FrameRingWriter,
        config: StartCameraWorker,
        send: Callable[[CameraWorkerMessage], object],
        stop: threading.Event,
    ) -> None:
        self._camera, self._ring, self._send, self._stop = camera, ring, send, stop
        self._is_live, self._timeouts = config.config.is_live, config.config.timeouts
        self._backoff = ExponentialBackoff(
            config.config.timeouts.initial_retry_s, config.config.timeouts.max_retry_s
        )
        self._earlier_counters, self._is_open = CameraCounters(), False
        self._phase, self._status = WorkerPhase.LAUNCHING, config.status
        self._last_heartbeat_s = 0.0

    def run(self) -> None:
        """Run the loop. Raises the camera's exceptions after which it is not opened again."""
        while not self._stop.is_set():
            try:
                self._open()
                self._stream()
            except EndOfStream:
                self._send(CameraFinished())
                return
            except CameraError as error:
                if not self._is_live:
                    raise
                self._enter_phase(
                    WorkerPhase.CLOSING, CameraStatus(self._state_after(error), str(error))
                )
            finally:
                self._close()
            self._wait_for_reconnect()

    def _open(self) -> None:
        self._enter_phase(WorkerPhase.OPENING, self._status)
        self._camera.open()
        self._is_open = True
        was_lost = self._status.state is CameraState.LOST
        status = self._status if was_lost else CameraStatus(CameraState.STARTING)
        self._enter_phase(WorkerPhase.STARTING, status)
        self._send_properties()

    def _close(self) -> None:
        self._enter_phase(WorkerPhase.CLOSING, self._status)
        self._camera.close()
        self._earlier_counters = self._counters()
        self._is_open = False

    def _stream(self) -> None:
        """Pass frames on until the loop is stopped."""
        waiting_since_s = time.monotonic()
        while not self._stop.is_set():
            self._send_heartbeat_if_due()
            if not self._ring.acquire(POLL_S):
                waiting_since_s = time.monotonic()
                continue
            try:
                frame = self._camera.read(POLL_S)
            except FrameTimeout:
                self._check_first_frame(waiting_since_s)
            else:
                self._ring.put(frame)
                self._enter_streaming()

    def _check_first_frame(self, since_s: float) -> None:
        """Raise CameraLostError if a live camera sends no first frame in time."""
        is_late = time.monotonic() - since_s > self._timeouts.first_frame_s
        if is_late and self._is_live and self._phase is WorkerPhase.STARTING:
            limit_s = self._timeouts.first_frame_s
            raise CameraLostError(
                self._camera.status.reason
                or f"{self._camera.name}: open, but sent no frame within {limit_s:g} s; "
                "it is opened again"
            )

    def _enter_streaming(self) -> None:
        if self._phase is WorkerPhase.STARTING:
            self._backoff.reset()
            self._enter_phase(WorkerPhase.STREAMING, CameraStatus(CameraState.STREAMING))
            self._send_properties()

    def _wait_for_reconnect(self) -> None:
        """Wait until the next attempt to open the camera."""
        if not self._stop.is_set():
            self._enter_phase(WorkerPhase.WAITING, self._status)
            self._camera.wait_for_reconnect(self._backoff.next_s())

    def _state_after(self, error: CameraError) -> CameraState:
        if isinstance(error, CameraNotFoundError):
            return CameraState.ABSENT
        return CameraState.OPENING if self._phase is WorkerPhase.OPENING else CameraState.LOST

    def _enter_phase(self, phase: WorkerPhase, status: CameraStatus) -> None:
        self._phase, self._status = phase, status
        self._send_heartbeat()

    def _send_heartbeat_if_due(self) -> None:
        """Send a heartbeat if the last one is old enough."""
        if time.monotonic() - self._last_heartbeat_s >= POLL_S:
            self._send_heartbeat()

    def _send_heartbeat(self) -> None:
        self._last_heartbeat_s = time.monotonic()
        self._send(CameraHeartbeat(self._phase, self._status_with_reason(), self._counters()))

    def _status_with_reason(self) -> CameraStatus:
        """Return the status with the camera's reason, such as many incomplete frames."""
        if self._phase is WorkerPhase.STREAMING:
            return replace(self._status, reason=self._camera.status.reason)
        return self._status

    def _counters(self) -> CameraCounters:
        """Return the totals; the camera's own counters restart at 0 whenever it is opened."""
        return (
            self._earlier_counters + self._camera.counters
            if self._is_open
            else self._earlier_counters
        )

    def _send_properties(self) -> None:
        camera = self._camera
        properties = CameraProperties(
            intrinsics_source=camera.intrinsics_source,
            frame_count=camera.frame_count,
            has_motor=camera.has_motor,
            ground_truth=camera.ground_truth,
        )
        self._send(properties)
