"""Supervision of a camera's worker process: start, time limits, kill and restart."""

import logging
import os
import threading
import time
from collections import deque
from contextlib import suppress

from drivers.camera import CameraCounters, CameraState, CameraStatus, EndOfStream
from drivers.core.errors import CameraLostError
from drivers.core.process.supervisor import ExponentialBackoff
from drivers.core.process.worker_process import LogMessage, WorkerProcess, WorkerSpec
from drivers.subprocess_camera.frame_ring import FrameRingReader
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    CameraWorkerMessage,
    DeviceRequest,
    StartCameraWorker,
    WorkerPhase,
)

_log = logging.getLogger(__name__)


CAMERA_WORKER = WorkerSpec("drivers.subprocess_camera.worker_main", "driver")


class CameraWorkerSupervisor:
    """Runs and restarts the worker process on a thread of its own, even while nobody reads frames.

    Status, properties and counters may be read at any time from any thread.
    """

    status: CameraStatus
    camera_properties: CameraProperties
    final_exception: Exception | None  # why no frame will follow

    def __init__(self, config: CameraWorkerConfig, ring: FrameRingReader) -> None:
        """The ring must be open from before `start` until after `stop`."""
        self._config, self._ring = config, ring
        self._lock = threading.Lock()
        self._thread = threading.Thread()
        self._is_done = threading.Event()
        self._is_done.set()
        # The last request of each type, for every new process.
        self._requests: dict[type[DeviceRequest], DeviceRequest] = {}
        self._unsent_requests: deque[DeviceRequest] = deque()  # for the running process
        self._reset()

    def start(self) -> None:
        """Start the thread and the worker process."""
        self._reset()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name="driver-supervisor", daemon=True)
        self._is_done.clear()
        self._thread.start()

    def wait_until_open(self) -> None:
        """Wait until the camera is open for the first time. Raises the error that prevents it."""
        self._is_settled.wait()
        if self.final_exception is not None and not self._was_open:
            raise self.final_exception

    def stop(self) -> None:
        """End the process in order if possible, otherwise by force. Safe to call at any time.

        If the call is interrupted, the thread still ends the process.
        """
        self._stopping.set()
        with self._lock:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)
        # Before `join`: a thread whose `join` was interrupted counts as ended in CPython 3.11.
        self._is_done.wait()
        if self._thread.is_alive():
            self._thread.join()

    def send_request(self, request: DeviceRequest) -> bool:
        """Send a request without waiting; return False if the camera is not open now.

        The request is applied again whenever the camera is opened.
        """
        with self._lock:
            self._requests[type(request)] = request
            if self._wake < 0:
                return False
            self._unsent_requests.append(request)
            os.eventfd_write(self._wake, 1)
            return self._phase in (WorkerPhase.STARTING, WorkerPhase.STREAMING)

    @property
    def counters(self) -> CameraCounters:
        """The camera's totals over all processes since `start`."""
        earlier, current = self._counted
        return earlier + current

    def _reset(self) -> None:
        self.status = CameraStatus(CameraState.OPENING)
        self.camera_properties, self.final_exception = CameraProperties(), None
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._phase, self._was_open = WorkerPhase.LAUNCHING, False
        self._backoff = ExponentialBackoff(
            self._config.timeouts.initial_retry_s, self._config.timeouts.max_retry_s
        )
        self._is_settled, self._stopping = threading.Event(), threading.Event()
        self._wake = -1

    def _run(self) -> None:
        """Body of the thread: run one process after another. Its errors reach the reader."""
        try:
            while not self._stopping.is_set() and self.final_exception is None:
                self._run_process()
                if self.final_exception is None:
                    self._stopping.wait(self._backoff.next_s())
        except Exception as error:
            self._finish(error)
        finally:
            self._is_settled.set()
            with self._lock:
                os.close(self._wake)
                self._wake = -1
            self._is_done.set()

    def _run_process(self) -> None:
        """Run one process from its start until it has ended."""
        self._phase = WorkerPhase.LAUNCHING
        if self._config.is_live:
            self._ring.allow_writes()
        try:
            with WorkerProcess(
                CAMERA_WORKER, self._ring.fds.all, self._config.timeouts.closing_s
            ) as process:
                process.send(self._start_message())
                fault = self._monitor(process)
        except OSError as error:
            self._handle_exit(f"cannot be started: {error.strerror}")
        else:
            self._handle_exit(fault or process.exit_reason)
        self._counted = self.counters, CameraCounters()

    def _start_message(self) -> StartCameraWorker:
        level = logging.getLogger().getEffectiveLevel()
        with self._lock:
            self._unsent_requests.clear()
            requests = tuple(self._requests.values())
        return StartCameraWorker(self._config, self._ring.fds, self.status, requests, level)

    def _monitor(self, process: WorkerProcess) -> str:
        """Receive messages until the process ends; return the fault if it had to be killed."""
        due_s = time.monotonic() + self._heartbeat_timeout_s()
        while not self._stopping.is_set():
            try:
                message: CameraWorkerMessage | None = process.receive(
                    max(0.0, due_s - time.monotonic()), self._wake
                )
            except EOFError:
                return ""
            self._send_pending_requests(process)
            if message is not None:
                self._handle_message(message)
            # A log message does not show that the capture loop runs: other threads log too.
            if isinstance(message, CameraHeartbeat):
                due_s = time.monotonic() + self._heartbeat_timeout_s()
            elif time.monotonic() >= due_s:
                process.kill()
                return f"hung while {self._phase}: no answer for {self._heartbeat_timeout_s():g} s"
        if self._phase in (WorkerPhase.LAUNCHING, WorkerPhase.WAITING):
            process.kill()  # there is no camera to close
        process.send(None)
        return ""

    def _send_pending_requests(self, process: WorkerProcess) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        while self._unsent_requests:
            process.send(self._unsent_requests.popleft())

    def _heartbeat_timeout_s(self) -> float:
        return self._config.timeouts.heartbeat_timeout_s(self._phase)

    def _handle_message(self, message: CameraWorkerMessage) -> None:
        match message:
            case CameraHeartbeat(phase, status, counters):
                self._phase, self.status = phase, status
                self._counted = self._counted[0], counters
                if phase is WorkerPhase.STREAMING:
                    self._backoff.reset()
            case CameraProperties():
                self.camera_properties, self._was_open = message, True
                self._is_settled.set()
            case CameraFinished(error):
                self._finish(error or EndOfStream())
            case LogMessage(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)

    def _handle_exit(self, reason: str) -> None:
        """Report the end of a process that was not stopped by the service."""
        if self.final_exception is not None or self._stopping.is_set():
            return
        text = f"the driver {reason}"
        _log.info("%s", text)
        if self._config.is_live:
            self._ring.reset()
            was_open = self._phase in (
                WorkerPhase.STARTING,
                WorkerPhase.STREAMING,
                WorkerPhase.CLOSING,
            )
            state = CameraState.LOST if was_open else CameraState.OPENING
            self.status = CameraStatus(state, text)
        else:
            self._finish(CameraLostError(f"{text}; open the recording again"))

    def _finish(self, exception: Exception) -> None:
        """End the stream after the frames in the ring."""
        self.final_exception = exception
        self._ring.finish()
        self._is_settled.set()
