"""Supervisor that keeps the viewer's process running while its sink is available."""

import logging
import threading
import time

from drivers.core.errors import UserFacingError
from drivers.core.process.supervisor import ExponentialBackoff
from drivers.core.process.worker_process import LogMessage, WorkerProcess, WorkerSpec
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
# Time to load Python, OpenCV and Rerun from a slow disk, with a third of a CPU.
LAUNCH_TIMEOUT_S = 60.0
# A process without a heartbeat for this long is killed.
MAX_SILENCE_S = 10.0
TICK_S = 0.25
# Longest wait for a killed process to exit.
KILL_TIMEOUT_S = 0.3
# Delays before a process that ended is started again.
INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S = 0.5, 30.0
# After a run of this length, the delay starts from its minimum again.
MIN_HEALTHY_RUN_S = 30.0


class RerunSupervisor:
    """Thread that starts, watches and restarts the viewer's process.

    Attributes:
        start_error: Why the first process could not start; None if it could.
        data_loss: Why data was lost, "" if none was.
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
        """Wait until the process draws or is known to be unable to. Raises `start_error`."""
        self._settled.wait(timeout_s)
        self._settled.set()
        if self.start_error is not None:
            raise self.start_error

    def expect_end(self) -> None:
        """Treat the end of the process as normal from now on."""
        self._stopping.set()

    def stop(self, timeout_s: float) -> bool:
        """Wait for the process to end. Return False if it was killed."""
        self.expect_end()
        self._thread.join(timeout_s)
        self._must_end.set()
        has_ended = not self._thread.is_alive()
        self._thread.join(TICK_S + REPLY_TIMEOUT_S)
        return has_ended

    def _run(self) -> None:
        """Run one process after another while there is a viewer; runs on the thread."""
        backoff = ExponentialBackoff(INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S)
        while not self._stopping.is_set() and self.start_error is None:
            if not self._health.connect():
                self._faults.set(self._absence_text())
                self._settled.set()
                self._stopping.wait(PROBE_PERIOD_S)
                continue
            begin_s = time.monotonic()
            fault = self._run_process()
            if not self._stopping.is_set() and self.start_error is None:
                self._faults.set(fault)
                if time.monotonic() - begin_s > MIN_HEALTHY_RUN_S:
                    backoff.reset()
                self._stopping.wait(backoff.next_s())
        self._health.disconnect()

    def _absence_text(self) -> str:
        return f"no viewer answers at {self._config.sink.address}; start one with: rerun"

    def _run_process(self) -> str:
        """Run one process to its end; return why it ended."""
        try:
            with WorkerProcess(RERUN_WORKER, (), KILL_TIMEOUT_S) as process:
                process.send(self._config)
                fault = self._receive_until_end(process)
                self._connection.disconnect()
        except OSError as error:
            return f"the viewer's process cannot be started: {error.strerror}; trying again"
        return fault or f"the viewer's process {process.exit_reason}; starting it again"

    def _receive_until_end(self, process: WorkerProcess) -> str:
        """Handle messages until the process ends or is killed; return why, "" if unknown."""
        due_s = time.monotonic() + LAUNCH_TIMEOUT_S
        exit_message = ""
        while (kill_reason := self._kill_reason(due_s)) == "":
            try:
                message: RerunWorkerMessage | None = process.receive(TICK_S)
            except EOFError:
                return exit_message
            if message is not None:
                due_s = time.monotonic() + MAX_SILENCE_S
                exit_message = self._handle(message, process)
        process.kill()
        return kill_reason

    def _kill_reason(self, due_s: float) -> str:
        """Return why the process must be killed now; "" if it need not."""
        if self._must_end.is_set():
            return "the viewer's process was stopped"
        if time.monotonic() >= due_s:
            return "the viewer's process hung; starting it again"
        return self._absence_text() if self._health.has_gone() else ""

    def _handle(self, message: RerunWorkerMessage, process: WorkerProcess) -> str:
        """Handle one message; return why the process will end, "" if it will not."""
        match message:
            case RerunReady():
                self._connection.connect(process)
                self._settled.set()
                if self._stopping.is_set():  # the shutdown was sent before the process connected
                    self._connection.send(RerunShutdown(), InitialState())
            case RerunHealth(fault, data_loss) if self._connection.is_connected:
                self.data_loss = self.data_loss or data_loss
                self._faults.set(fault)
            case RerunWorkerFailed(error):
                if not self._settled.is_set():  # `wait_until_settled` raises the error
                    self.start_error = error
                    self._settled.set()
                return str(error)
            case LogMessage(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
        return ""
