"""Keeps the viewer's process running while there is somewhere to show pictures."""

import logging
import threading
import time

from drivers.core.errors import UserFacingError
from drivers.core.process.backoff import ExponentialBackoff
from drivers.core.process.messages import LogMessage
from drivers.core.process.worker_process import WorkerProcess, WorkerSpec
from vo_service.outputs.rerun.fault_reporter import RerunFaultReporter
from vo_service.outputs.rerun.messages import (
    InitialState,
    RerunHealth,
    RerunReady,
    RerunShutdown,
    RerunWorkerConfig,
    RerunWorkerFailed,
    RerunWorkerMessage,
)
from vo_service.outputs.rerun.viewer_probe import (
    PROBE_PERIOD_S,
    REPLY_TIMEOUT_S,
    ViewerHealthMonitor,
)
from vo_service.outputs.rerun.worker_connection import WorkerConnection

RERUN_WORKER = WorkerSpec("vo_service.outputs.rerun.worker_main", "viewer")
# Python, OpenCV and Rerun, from a slow disk, with a third of a processor.
LAUNCH_TIMEOUT_S = 60.0
# A process that says nothing for so long is killed.
MAX_SILENCE_S = 10.0
TICK_S = 0.25
# For a process that was killed, until nothing is left of it.
KILL_TIMEOUT_S = 0.3
# Waits before a process that ended is started again.
INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S = 0.5, 30.0
# One that ran for so long has not failed at once.
MIN_HEALTHY_RUN_S = 30.0


class RerunSupervisor:
    """A thread that owns the process: starts it, watches it, starts it again.

    refusal     why the first process could not be, if it could not
    incomplete  what could not be kept, "" if everything was
    """

    def __init__(
        self, config: RerunWorkerConfig, connection: WorkerConnection, faults: RerunFaultReporter
    ) -> None:
        self._config, self._connection, self._faults = config, connection, faults
        self._health = ViewerHealthMonitor(config.sink.make_probe())
        self._settled, self._stopping = threading.Event(), threading.Event()
        self._must_end = threading.Event()
        self.start_error: UserFacingError | None = None
        self.data_loss = ""
        self._thread = threading.Thread(target=self._run, name="viewer-supervisor", daemon=True)
        self._thread.start()

    def wait_until_settled(self, timeout_s: float) -> None:
        """Until pictures are drawn, or it is known why not. Raises what makes it impossible."""
        self._settled.wait(timeout_s)
        self._settled.set()
        if self.start_error is not None:
            raise self.start_error

    def expect_end(self) -> None:
        """The process is about to be told to end: that is no trouble."""
        self._stopping.set()

    def stop(self, timeout_s: float) -> bool:
        """Wait for the process to end, as it was told to. False if it had to be killed."""
        self.expect_end()
        self._thread.join(timeout_s)
        self._must_end.set()
        has_ended = not self._thread.is_alive()
        self._thread.join(TICK_S + REPLY_TIMEOUT_S)
        return has_ended

    def _run(self) -> None:
        """Body of the thread: one process after another, while there is a viewer."""
        back_off = ExponentialBackoff(INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S)
        while not self._stopping.is_set() and self.start_error is None:
            if not self._health.connect():
                self._faults.set(self._absence_text())
                self._settled.set()
                self._stopping.wait(PROBE_PERIOD_S)
                continue
            begin_s = time.monotonic()
            trouble = self._run_process()
            if not self._stopping.is_set() and self.start_error is None:
                self._faults.set(trouble)
                if time.monotonic() - begin_s > MIN_HEALTHY_RUN_S:
                    back_off.reset()
                self._stopping.wait(back_off.next_s())
        self._health.disconnect()

    def _absence_text(self) -> str:
        return f"no viewer answers at {self._config.sink.address}; start one with: rerun"

    def _run_process(self) -> str:
        """From the start of a process until nothing is left of it; returns why it ended."""
        try:
            with WorkerProcess(RERUN_WORKER, (), KILL_TIMEOUT_S) as process:
                process.send(self._config)
                trouble = self._receive_until_end(process)
                self._connection.disconnect()
        except OSError as error:
            return f"the viewer's process cannot be started: {error.strerror}; trying again"
        return trouble or f"the viewer's process {process.exit_reason}; starting it again"

    def _receive_until_end(self, process: WorkerProcess) -> str:
        """Listen until it ends, or must; returns why, if that is known."""
        due_s = time.monotonic() + LAUNCH_TIMEOUT_S
        said = ""
        while (trouble := self._kill_reason(due_s)) == "":
            try:
                word: RerunWorkerMessage | None = process.receive(TICK_S)
            except EOFError:
                return said
            if word is not None:
                due_s = time.monotonic() + MAX_SILENCE_S
                said = self._handle(word, process)
        process.kill()
        return trouble

    def _kill_reason(self, due_s: float) -> str:
        """Why the process must end now; "" if it need not."""
        if self._must_end.is_set():
            return "the viewer's process was stopped"
        if time.monotonic() >= due_s:
            return "the viewer's process hung; starting it again"
        return self._absence_text() if self._health.has_gone() else ""

    def _handle(self, message: RerunWorkerMessage, process: WorkerProcess) -> str:
        """Returns why the process will end, if it says so."""
        match message:
            case RerunReady():
                self._connection.connect(process)
                self._settled.set()
                if self._stopping.is_set():  # it was told to nobody
                    self._connection.send(RerunShutdown(), InitialState())
            case RerunHealth(trouble, incomplete) if self._connection.is_connected:
                self.data_loss = self.data_loss or incomplete
                self._faults.set(trouble)
            case RerunWorkerFailed(error):
                if not self._settled.is_set():  # then it is the caller's affair
                    self.start_error = error
                    self._settled.set()
                return str(error)
            case LogMessage(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
        return ""
