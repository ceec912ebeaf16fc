"""Pictures of what the odometry sees and does, in Rerun, drawn by a process of their own.

Rerun is optional and large, and it can block for ever: nothing in the service's process loads it.
"""

import logging
import time
import uuid
from collections.abc import Iterable

from drivers.camera import PlaybackMode
from drivers.core.errors import UserFacingError
from drivers.core.queues import WorkerThread
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.fault_reporter import RerunFaultReporter
from vo_service.outputs.rerun.messages import (
    RerunMessage,
    RerunShutdown,
    RerunWorkerConfig,
    TextLog,
)
from vo_service.outputs.rerun.sinks import PortTakenError, Sink
from vo_service.outputs.rerun.supervisor import RerunSupervisor
from vo_service.outputs.rerun.targets import make_sink, prepare_rerun
from vo_service.outputs.rerun.update_encoder import UpdateEncoder
from vo_service.outputs.rerun.worker_connection import WorkerConnection
from vo_service.types import GroundTruthSource, OdometryUpdate, Status, no_ground_truth

# What the process may take before the first frame; then frames come without it.
START_TIMEOUT_S = 10.0
# A viewer that does not take the last of its data is left after this long.
CLOSE_TIMEOUT_S = 1.4
# How often ports are looked for, as somebody else may take them in between.
MAX_PORT_ATTEMPTS = 3

PAUSED_TEXT, RESUMED_TEXT = "resting: the machine is too slow", "drawing again"

logger = logging.getLogger(__name__)


class RerunOutput:
    """Shows results in one place; give each place an output, and so a process, of its own.

    Numbers (pose, counts, times) go out for every frame, pictures `picture_hz` times a second. It
    does not block: results that come faster than they are taken are dropped, oldest first, and
    counted; only a file in lockstep makes a replay wait. A process that ends is started again,
    and draws what was there. `ground_truth` is drawn beside the estimate where it is known.

    Raises InputError if Rerun is not installed or the file is wrong, UserFacingError if a port is
    taken.
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
        self._connection = WorkerConnection()
        self._faults = RerunFaultReporter(sink.address)
        self._encoder = UpdateEncoder(sink, 1.0 / settings.picture_hz, ground_truth)
        level = logging.getLogger().getEffectiveLevel()
        job = RerunWorkerConfig(
            sink, settings.jpeg_quality, settings.memory_mb, str(uuid.uuid4()), level
        )
        self._supervisor = RerunSupervisor(job, self._connection, self._faults)
        self._worker: WorkerThread[OdometryUpdate | Status | TextLog] = WorkerThread(
            "viewer", sink.make_queue(playback_mode), self._handle, self._finish
        )
        try:
            self._supervisor.wait_until_settled(START_TIMEOUT_S)
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> str:
        """What a person opens to see it."""
        return self._sink.address

    @property
    def warning(self) -> str:
        """What is wrong with the pictures now; "" while all is well."""
        return self._faults.warning

    @property
    def dropped(self) -> int:
        """Results that newer ones replaced before they were drawn."""
        return self._worker.dropped

    def on_update(self, update: OdometryUpdate) -> None:
        """Draw one result (soon)."""
        if not self._is_paused:
            self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Show a change of state (soon)."""
        if not self._is_paused:
            self._worker.put(status)

    def set_paused(self, is_paused: bool) -> None:
        """Draw nothing while the machine is too slow; the log beside the pictures says so."""
        if is_paused != self._is_paused:
            self._is_paused = is_paused
            self._worker.put(TextLog(PAUSED_TEXT if is_paused else RESUMED_TEXT))

    def close(self) -> None:
        """Finish the recording, within 2.5 s.

        Raises UserFacingError, the first time, if not everything could be kept.
        """
        due_s = time.monotonic() + CLOSE_TIMEOUT_S
        self._worker.close(CLOSE_TIMEOUT_S)
        has_ended = self._supervisor.stop(max(0.0, due_s - time.monotonic()))
        if not has_ended:
            logger.warning("rerun: %s did not take all data in time; the end is lost", self.address)
        is_incomplete = self._supervisor.data_loss or (self._sink.is_persistent and not has_ended)
        if is_incomplete and not self._is_closed:
            self._is_closed = True
            raise UserFacingError(f"{self.address}: the recording is not complete")
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
        self._supervisor.expect_end()
        self._send([*self._encoder.encode_pending(), RerunShutdown()])

    def _send(self, messages: Iterable[RerunMessage]) -> None:
        for message in messages:
            self._connection.send(message, self._encoder.initial_state)


def open_rerun_output(
    target: str,
    settings: RerunConfig = RerunConfig(),  # noqa: B008 (frozen)
    ground_truth: GroundTruthSource = no_ground_truth,
    playback_mode: PlaybackMode = PlaybackMode.REALTIME,
) -> RerunOutput:
    """Open a target as users write it: serve, connect, connect:HOST:PORT or FILE.rrd.

    Raises what `RerunOutput` raises, and InputError for anything else.
    """
    for _ in range(MAX_PORT_ATTEMPTS - 1):
        try:
            return RerunOutput(make_sink(target, settings), settings, ground_truth, playback_mode)
        except PortTakenError:  # by somebody who was looking for one at the same time
            continue
    return RerunOutput(make_sink(target, settings), settings, ground_truth, playback_mode)
