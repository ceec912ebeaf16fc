"""Keeps a driver's process running: starts it, watches the clock, kills it, starts it again."""

import logging
import os
import threading
import time
from collections import deque
from contextlib import suppress

from drivers.camera import CameraCounters, CameraState, CameraStatus, EndOfStream
from drivers.core.errors import CameraLostError
from drivers.core.process.backoff import ExponentialBackoff
from drivers.core.process.messages import LogMessage
from drivers.core.process.worker_process import WorkerProcess, WorkerSpec
from drivers.subprocess_camera.device_requests import DeviceRequest
from drivers.subprocess_camera.frame_ring import FrameRingReader
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    CameraWorkerMessage,
    StartCameraWorker,
)
from drivers.subprocess_camera.timeouts import WorkerPhase

_log = logging.getLogger(__name__)

CAMERA_WORKER = WorkerSpec("drivers.subprocess_camera.worker_main", "driver")


class CameraWorkerSupervisor:
    """A thread that owns the process, so that it is watched even while nobody reads frames.

    What is known of the camera can be asked for at any time, from any thread.
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
        self._requests: dict[
            type[DeviceRequest], DeviceRequest
        ] = {}  # for every process from now on
        self._unsent_requests: deque[DeviceRequest] = deque()  # to the process that runs
        self._reset()

    def start(self) -> None:
        """Begin."""
        self._reset()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name="driver-supervisor", daemon=True)
        self._is_done.clear()
        self._thread.start()

    def wait_until_open(self) -> None:
        """Until the camera is open for the first time. Raises what kept it from that."""
        self._is_settled.wait()
        if self.final_exception is not None and not self._was_open:
            raise self.final_exception

    def stop(self) -> None:
        """End the process: in order if it can, by force if not. Safe to call at any time.

        An interrupted call does no harm: the thread brings it to an end.
        """
        self._stopping.set()
        with self._lock:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)
        # Not `join` at once: a thread whose `join` was interrupted counts as ended in CPython 3.11.
        self._is_done.wait()
        if self._thread.is_alive():
            self._thread.join()

    def send_request(self, request: DeviceRequest) -> bool:
        """Pass a wish on, without waiting; False if the camera is not open to hear it now.

        It is then done when the camera is opened, as it is again whenever the camera is.
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
        """What the camera counted, in all processes since `start`."""
        before, now = self._counted
        return before + now

    def _reset(self) -> None:
        self.status, self.camera_properties, self.final_exception = (
            CameraStatus(CameraState.OPENING),
            CameraProperties(),
            None,
        )
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._phase, self._was_open = WorkerPhase.LAUNCHING, False
        self._backoff = ExponentialBackoff(
            self._config.timeouts.initial_retry_s, self._config.timeouts.max_retry_s
        )
        self._is_settled, self._stopping = threading.Event(), threading.Event()
        self._wake = -1

    def _run(self) -> None:
        """Body of the thread: one process after another. Errors in it reach the reader."""
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
        """From the start of a process until nothing is left of it."""
        self._phase = WorkerPhase.LAUNCHING
        if self._config.is_live:
            self._ring.allow_writes()
        try:
            with WorkerProcess(
                CAMERA_WORKER, self._ring.fds.all, self._config.timeouts.closing_s
            ) as process:
                process.send(self._start_message())
                trouble = self._monitor(process)
        except OSError as error:
            self._handle_exit(f"cannot be started: {error.strerror}")
        else:
            self._handle_exit(trouble or process.exit_reason)
        self._counted = self.counters, CameraCounters()

    def _start_message(self) -> StartCameraWorker:
        level = logging.getLogger().getEffectiveLevel()
        with self._lock:
            self._unsent_requests.clear()
            wishes = tuple(self._requests.values())
        return StartCameraWorker(self._config, self._ring.fds, self.status, wishes, level)

    def _monitor(self, process: WorkerProcess) -> str:
        """Listen until it ends, or must: returns what is wrong with it if it had to be killed."""
        due_s = time.monotonic() + self._heartbeat_timeout_s()
        while not self._stopping.is_set():
            try:
                word: CameraWorkerMessage | None = process.receive(
                    max(0.0, due_s - time.monotonic()), self._wake
                )
            except EOFError:
                return ""
            self._send_pending_requests(process)
            if word is not None:
                self._handle_message(word)
            if isinstance(
                word, CameraHeartbeat
            ):  # a log line is no sign of life: other threads log too
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
            case CameraHeartbeat(phase, condition, counters):
                self._phase, self.status = phase, condition
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
        """Say what became of a process that nobody told to end."""
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
        """No frame will follow those in the ring."""
        self.final_exception = exception
        self._ring.finish()
        self._is_settled.set()
