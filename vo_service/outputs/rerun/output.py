"""Visualization in Rerun, drawn by a separate process.

Rerun is optional and large, and it can block forever: the service's process never loads it.
"""

import logging
import threading
import time
import uuid
from collections.abc import Callable, Iterable
from dataclasses import replace

from drivers.camera import PlaybackMode
from drivers.core import UserFacingError
from drivers.core.flow_control import ExponentialBackoff, WorkerThread
from drivers.core.process.client import WorkerClient
from drivers.core.process.messages import Shutdown, WorkerFailed
from drivers.core.process.worker_spec import WorkerSpec
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.messages import (
    InitialState,
    RerunHealth,
    RerunMessage,
    RerunWorkerConfig,
    RerunWorkerMessage,
    TextLog,
)
from vo_service.outputs.rerun.sinks import PortTakenError, Sink, ViewerGoneError
from vo_service.outputs.rerun.targets import make_sink, prepare_rerun
from vo_service.outputs.rerun.update_encoder import UpdateEncoder
from vo_service.types import OdometryUpdate
from vo_service.types.messages import Status
from vo_service.types.outputs import GroundTruthSource, no_ground_truth

logger = logging.getLogger(__name__)

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
        self._supervisor = WorkerClient(
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


# Longest wait for the process before the first frame; then frames are processed without it.
START_TIMEOUT_S = 10.0
# Longest wait, at the end, for a viewer to take its last data.
CLOSE_TIMEOUT_S = 1.4
# Another program may take a free port before the process opens it.
MAX_PORT_ATTEMPTS = 3

PAUSED_TEXT, RESUMED_TEXT = "paused: the machine is too slow", "drawing again"


class RerunOutput:
    """Shows results in one sink, through one process; several sinks need several outputs.

    Scalars (pose, counts, times) are sent for every frame, images `picture_hz` times a second. The
    output never blocks: if the sink is slow, the oldest results are dropped and counted. Only a
    file in lockstep makes a replay wait. A process that ends is restarted and draws everything
    again.

    Args:
        sink: Where the data goes.
        settings: Rates and limits.
        ground_truth: Returns the true trajectory once it is known, to be drawn too.
        playback_mode: Whether a replay may wait for the output.

    Raises:
        InputError: Rerun is not installed, or the file is not usable.
        PortTakenError: A port is in use.
    """

    def __init__(
        self,
        sink: Sink,
        settings: RerunConfig = RerunConfig(),  # noqa: B008 (frozen)
        ground_truth: GroundTruthSource = no_ground_truth,
        playback_mode: PlaybackMode = PlaybackMode.REALTIME,
    ) -> None:
        prepare_rerun()
        self._sink = sink
        self._is_paused = self._is_closed = False
        self._encoder = UpdateEncoder(sink, 1.0 / settings.picture_hz, ground_truth)
        config = RerunWorkerConfig(sink, settings.jpeg_quality, str(uuid.uuid4()))
        self._client = RerunClient(config, settings.memory_mb, lambda: self._encoder.initial_state)
        self._worker: WorkerThread[OdometryUpdate | Status | TextLog] = WorkerThread(
            "viewer", sink.make_queue(playback_mode), self._handle, self._finish
        )
        try:
            self._client.wait_until_settled(START_TIMEOUT_S)
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> str:
        """The address or file that the user opens."""
        return self._sink.address

    @property
    def warning(self) -> str:
        """The current fault; "" if there is none."""
        return self._client.warning

    @property
    def dropped(self) -> int:
        """Number of results dropped from the queue."""
        return self._worker.dropped

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue one result."""
        if not self._is_paused:
            self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        if not self._is_paused:
            self._worker.put(status)

    def set_paused(self, is_paused: bool) -> None:
        """Pause or resume drawing; the viewer's text log says so."""
        if is_paused != self._is_paused:
            self._is_paused = is_paused
            self._worker.put(TextLog(PAUSED_TEXT if is_paused else RESUMED_TEXT))

    def close(self) -> None:
        """Finish the recording within 2.5 s.

        Raises:
            UserFacingError: Data was lost; raised by the first call only.
        """
        due_s = time.monotonic() + CLOSE_TIMEOUT_S
        self._worker.close(CLOSE_TIMEOUT_S)
        has_ended = self._client.close(max(0.0, due_s - time.monotonic()))
        if not has_ended:
            logger.warning("rerun: %s was too slow; the last data is lost", self.address)
        is_incomplete = self._client.data_loss or (self._sink.is_persistent and not has_ended)
        if is_incomplete and not self._is_closed:
            self._is_closed = True
            raise UserFacingError(f"{self.address}: the recording is incomplete")
        self._is_closed = True

    def _handle(self, item: OdometryUpdate | Status | TextLog) -> None:
        match item:
            case OdometryUpdate():
                self._send(self._encoder.encode_update(item))
            case Status():
                self._send([self._encoder.encode_status(item)])
            case TextLog():
                self._send([item])

    def _finish(self) -> None:
        self._send(self._encoder.encode_pending())
        self._client.send(Shutdown())

    def _send(self, messages: Iterable[RerunMessage]) -> None:
        for message in messages:
            self._client.send(message)


def open_rerun_output(
    target: str,
    settings: RerunConfig = RerunConfig(),  # noqa: B008 (frozen)
    ground_truth: GroundTruthSource = no_ground_truth,
    playback_mode: PlaybackMode = PlaybackMode.REALTIME,
) -> RerunOutput:
    """Open a target as users write it: serve, connect, connect:HOST:PORT or FILE.rrd.

    Args:
        target: The target.
        settings: Rates and limits.
        ground_truth: As for `RerunOutput`.
        playback_mode: As for `RerunOutput`.

    Raises:
        InputError: As `RerunOutput`, or the target is invalid.
        PortTakenError: As `RerunOutput`.
    """
    for _ in range(MAX_PORT_ATTEMPTS - 1):
        try:
            return RerunOutput(make_sink(target, settings), settings, ground_truth, playback_mode)
        except PortTakenError:  # another program took the port after `make_sink` found it free
            continue
    return RerunOutput(make_sink(target, settings), settings, ground_truth, playback_mode)
