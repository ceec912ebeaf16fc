"""Visualization in Rerun, drawn by a separate process.

Rerun is optional and large, and it can block forever: the service's process never loads it.
"""

import logging
import threading
import time
import uuid
from collections.abc import Iterable
from dataclasses import replace

from drivers.camera import PlaybackMode
from drivers.core import UserFacingError
from drivers.core.process.messages import Shutdown, WorkerFailed
from drivers.core.process.worker_spec import WorkerSpec
from drivers.core.rate_limits import ExponentialBackoff
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.messages import (
    RerunHealth,
    RerunMessage,
    RerunWorkerConfig,
    RerunWorkerMessage,
    TextLog,
)
from vo_service.outputs.rerun.sinks import PortTakenError, Sink, ViewerGoneError
from vo_service.outputs.rerun.targets import make_sink, prepare_rerun
from vo_service.outputs.rerun.update_encoder import UpdateEncoder
from vo_service.process_output import FaultReporter, ProcessOutput
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate
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
# Longest wait for the process before the first frame; then frames are processed without it.
START_TIMEOUT_S = 10.0
# Longest wait, at the end, for a viewer to take its last data.
CLOSE_TIMEOUT_S = 1.4
# Another program may take a free port before the process opens it.
MAX_PORT_ATTEMPTS = 3

PAUSED_TEXT, RESUMED_TEXT = "paused: the machine is too slow", "drawing again"


class RerunFaultReporter(FaultReporter):
    """Logs the same fault rarely, because a viewer may come and go, and logs the end of a fault."""

    def __init__(self, address: str) -> None:
        super().__init__("rerun", logging.WARNING)
        self._address = address
        self._logged_s: dict[str, float] = {}

    def set(self, text: str) -> None:
        """Set the current fault, "" for none."""
        if self.text and not text:
            logger.info("rerun: drawing at %s again", self._address)
        super().set(text)

    def _is_news(self, text: str) -> bool:
        now_s = time.monotonic()
        is_news = now_s - self._logged_s.get(text, float("-inf")) > REPEAT_AFTER_S
        if is_news:
            self._logged_s[text] = now_s
        return is_news


class RerunOutput(ProcessOutput[OdometryUpdate | Status | TextLog, RerunWorkerConfig]):
    """Shows results in one sink, through one process; several sinks need several outputs.

    Scalars (pose, counts, times) are sent for every frame, images `picture_hz` times a second. The
    output never blocks: if the sink is slow, the oldest results are dropped and counted. Only a
    file in lockstep makes a replay wait. A process that ends is restarted, while its sink is there,
    and draws everything again.

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
        super().__init__("rerun", CLOSE_TIMEOUT_S)
        self._sink = sink
        self._is_paused = False
        self._encoder = UpdateEncoder(sink, 1.0 / settings.picture_hz, ground_truth)
        self._faults = RerunFaultReporter(sink.address)
        self._settled = threading.Event()  # it draws, or is known to be unable to
        self._start_error: UserFacingError | None = None
        self._last_error = self._data_loss = ""
        self._initialized = 0  # the last process that has the initial state
        self._start(
            replace(RERUN_WORKER, memory_mb=settings.memory_mb),
            RerunWorkerConfig(sink, settings.jpeg_quality, str(uuid.uuid4())),
            sink.make_queue(playback_mode),
            ExponentialBackoff(INITIAL_RESTART_DELAY_S, MAX_RESTART_DELAY_S),
        )
        try:
            self._wait_until_settled()
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> str:
        """The address or file that the user opens."""
        return self._sink.address

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue one result."""
        if not self._is_paused:
            self._thread.put(update)

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        if not self._is_paused:
            self._thread.put(status)

    def set_paused(self, is_paused: bool) -> None:
        """Pause or resume drawing; the viewer's text log says so."""
        if is_paused != self._is_paused:
            self._is_paused = is_paused
            self._thread.put(TextLog(PAUSED_TEXT if is_paused else RESUMED_TEXT))

    @property
    def _fault(self) -> str:
        return self._faults.text

    def _wait_until_settled(self) -> None:
        """Wait until the process draws or is known to be unable to. Raises why it cannot start."""
        self._settled.wait(START_TIMEOUT_S)
        self._settled.set()
        if self._start_error is not None:
            raise self._start_error

    def _pass_on(self, item: OdometryUpdate | Status | TextLog) -> None:
        match item:
            case OdometryUpdate():
                self._send(self._encoder.encode_update(item))
            case Status():
                self._send([self._encoder.encode_status(item)])
            case TextLog():
                self._send([item])

    def _finish(self) -> None:
        self._send(self._encoder.encode_pending())
        self._send([Shutdown()])

    def _send(self, messages: Iterable[RerunMessage | Shutdown]) -> None:
        """Send messages; without a process they are lost.

        A process that does not read blocks the sender until it reads or is killed.
        """
        for message in messages:
            if self._initialized != (count := self._client.ready_count):
                self._initialized = count
                self._client.send_waiting(self._encoder.initial_state)
            self._client.send_waiting(message)

    def _make_config(self) -> RerunWorkerConfig | None:
        if self._sink.is_present():
            return self._config
        self._faults.set(self._sink.absence_text)
        self._settled.set()
        return None

    def _handle_message(self, message: RerunWorkerMessage) -> None:
        match message:
            case RerunHealth(fault, data_loss):
                self._data_loss = self._data_loss or data_loss
                self._faults.set(fault)
                self._settled.set()
            case WorkerFailed(error):
                self._last_error = str(error)
                is_first = not self._settled.is_set()
                if is_first and not isinstance(error, ViewerGoneError):
                    self._start_error = error  # `_wait_until_settled` raises it
                self._settled.set()

    def _handle_exit(self, reason: str) -> bool:
        """Report why the process ended; return whether it is started again."""
        if self._start_error is not None:
            return False
        own_text, self._last_error = self._last_error, ""
        self._faults.set(own_text or f"the viewer's process {reason}; starting it again")
        return True

    def _end(self, has_finished: bool, left_s: float) -> None:
        """End the recording within 2.5 s.

        Raises:
            UserFacingError: Data was lost.
        """
        has_ended = self._client.close(left_s)
        if not has_ended:
            logger.warning("rerun: %s was too slow; the last data is lost", self.address)
        if self._data_loss or (self._sink.is_persistent and not has_ended):
            raise UserFacingError(f"{self.address}: the recording is incomplete")


def open_rerun_output(
    target: str,
    settings: RerunConfig = RerunConfig(),  # noqa: B008 (frozen)
    ground_truth: GroundTruthSource = no_ground_truth,
    playback_mode: PlaybackMode = PlaybackMode.REALTIME,
) -> RerunOutput:
    """Open a target as users write it: serve, connect, connect:HOST:PORT or FILE.rrd.

    Args:
        ground_truth: As for `RerunOutput`.
        playback_mode: As for `RerunOutput`.

    Raises:
        InputError: As `RerunOutput`, or the target is invalid.
        PortTakenError: As `RerunOutput`.
    """
    for _ in range(MAX_PORT_ATTEMPTS - 1):
        try:
            sink = make_sink(target, settings)
            return RerunOutput(sink, settings, ground_truth, playback_mode)
        except PortTakenError:  # another program took the port after `make_sink` found it free
            continue
    return RerunOutput(make_sink(target, settings), settings, ground_truth, playback_mode)
