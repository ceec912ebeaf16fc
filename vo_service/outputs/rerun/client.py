"""The service's side of the viewer's process: messages, faults and restarts."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.core.errors import UserFacingError
from drivers.core.process.messages import Shutdown, WorkerFailed
from drivers.core.process.supervisor import ExponentialBackoff, WorkerSupervisor
from drivers.core.process.worker_process import WorkerSpec
from vo_service.outputs.rerun.messages import (
    InitialState,
    RerunHealth,
    RerunMessage,
    RerunWorkerConfig,
    RerunWorkerMessage,
)
from vo_service.outputs.rerun.sinks import ViewerGoneError

RERUN_WORKER = WorkerSpec(
    "vo_service.outputs.rerun.worker:run_viewer",
    "viewer",
    start_timeout_s=60.0,  # Python, OpenCV and Rerun from a slow disk, with a third of a CPU
    heartbeat_timeout_s=10.0,
    exit_timeout_s=5.0,
    nice=5,
    memory_key="rerun.memory_mb",
)
INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S = 0.5, 30.0
# The same fault is logged again after this long.
REPEAT_AFTER_S = 600.0

logger = logging.getLogger(__name__)


class RerunFaultReporter:
    """The current fault: in the status while it lasts, in the log once.

    Attributes:
        warning: The current fault, "" if there is none.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._logged_s: dict[str, float] = {}
        self.warning = ""

    def set(self, fault: str) -> None:
        """Set the current fault; "" clears it."""
        if not fault:
            self._clear()
            return
        self.warning = f"rerun: {fault}"
        if time.monotonic() - self._logged_s.get(fault, float("-inf")) > REPEAT_AFTER_S:
            self._logged_s[fault] = time.monotonic()
            logger.warning("%s", self.warning)

    def _clear(self) -> None:
        if self.warning:
            self.warning = ""
            logger.info("rerun: drawing at %s again", self._address)


class RerunClient:
    """Keeps the viewer's process running while its sink is there, and sends it what to draw.

    Args:
        config: What the process does.
        memory_mb: Its memory limit.
        initial_state: Returns everything drawn so far; it is sent first to each new process.

    Attributes:
        data_loss: Why data was lost, "" if none was.
    """

    def __init__(
        self,
        config: RerunWorkerConfig,
        memory_mb: int,
        initial_state: Callable[[], InitialState],
    ) -> None:
        self._config, self._initial_state = config, initial_state
        self._faults = RerunFaultReporter(config.sink.address)
        self._settled = threading.Event()  # it draws, or is known to be unable to
        self._start_error: UserFacingError | None = None
        self._last_error = ""
        self.data_loss = ""
        self._initialized = 0  # the last process that has the initial state
        self._supervisor = WorkerSupervisor(
            replace(RERUN_WORKER, memory_mb=memory_mb),
            self._make_config,
            self._handle_message,
            self._handle_exit,
            ExponentialBackoff(INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S),
        )

    @property
    def warning(self) -> str:
        """The current fault; "" if there is none."""
        return self._faults.warning

    def wait_until_settled(self, timeout_s: float) -> None:
        """Wait until the process draws or is known to be unable to. Raises why it cannot start."""
        self._settled.wait(timeout_s)
        self._settled.set()
        if self._start_error is not None:
            raise self._start_error

    def send(self, message: RerunMessage | Shutdown) -> None:
        """Send a message; without a process it is lost.

        A process that does not read blocks the sender until it reads or is killed.
        """
        if self._initialized != (count := self._supervisor.ready_count):
            self._initialized = count
            self._supervisor.send_waiting(self._initial_state())
        self._supervisor.send_waiting(message)

    def close(self, timeout_s: float) -> bool:
        """Wait for the process to end. Return False if it was killed."""
        return self._supervisor.close(timeout_s)

    def _make_config(self) -> RerunWorkerConfig | None:
        if self._config.sink.is_present():
            return self._config
        self._faults.set(self._config.sink.absence_text)
        self._settled.set()
        return None

    def _handle_message(self, message: RerunWorkerMessage) -> None:
        match message:
            case RerunHealth(fault, data_loss):
                self.data_loss = self.data_loss or data_loss
                self._faults.set(fault)
                self._settled.set()
            case WorkerFailed(error):
                self._last_error = str(error)
                is_first = not self._settled.is_set()
                if is_first and not isinstance(error, ViewerGoneError):
                    self._start_error = error  # `wait_until_settled` raises it
                self._settled.set()

    def _handle_exit(self, reason: str) -> bool:
        """Report why the process ended; return whether it is started again."""
        if self._start_error is not None:
            return False
        own_text, self._last_error = self._last_error, ""
        self._faults.set(own_text or f"the viewer's process {reason}; starting it again")
        return True
