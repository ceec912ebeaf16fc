"""Pictures of what the odometry sees and does, in Rerun, drawn by a process of their own.

Rerun is optional and large, and it can block for ever: nothing in the service's process loads it.
"""

import logging
import time
import uuid
from collections.abc import Iterable

from drivers.camera import Pace
from drivers.errors import UserFacingError
from vo_service.outputs.worker import Worker
from vo_service.settings import RerunSettings
from vo_service.types import PoseUpdate, Status, TruthSource, no_truth
from vo_service.viewer.link import Link
from vo_service.viewer.messages import Finish, Job, Message, Note
from vo_service.viewer.notices import Notices
from vo_service.viewer.sinks import PortTakenError, Sink
from vo_service.viewer.sketching import Sketcher
from vo_service.viewer.supervisor import Supervisor
from vo_service.viewer.targets import prepare_rerun, sink_of

# What the process may take before the first frame; then frames come without it.
STARTING_S = 10.0
# A viewer that does not take the last of its data is left after this long.
CLOSING_S = 1.4
# How often ports are looked for, as somebody else may take them in between.
ATTEMPTS = 3

RESTING, DRAWING = "resting: the machine is too slow", "drawing again"

logger = logging.getLogger(__name__)


class ViewerOutput:
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
        settings: RerunSettings = RerunSettings(),  # noqa: B008 (frozen)
        ground_truth: TruthSource = no_truth,
        pace: Pace = Pace.REALTIME,
    ) -> None:
        prepare_rerun()
        self._sink = sink
        self._is_resting = self._is_closed = False
        self._link = Link()
        self._notices = Notices(sink.address)
        self._sketcher = Sketcher(sink, 1.0 / settings.picture_hz, ground_truth)
        level = logging.getLogger().getEffectiveLevel()
        job = Job(sink, settings.jpeg_quality, settings.memory_mb, str(uuid.uuid4()), level)
        self._supervisor = Supervisor(job, self._link, self._notices)
        self._worker: Worker[PoseUpdate | Status | Note] = Worker(
            "viewer", sink.hand_over(pace), self._hand_over, self._finish
        )
        try:
            self._supervisor.wait_until_settled(STARTING_S)
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
        return self._notices.warning

    @property
    def dropped(self) -> int:
        """Results that newer ones replaced before they were drawn."""
        return self._worker.dropped

    def pose(self, update: PoseUpdate) -> None:
        """Draw one result (soon)."""
        if not self._is_resting:
            self._worker.put(update)

    def status(self, status: Status) -> None:
        """Show a change of state (soon)."""
        if not self._is_resting:
            self._worker.put(status)

    def rest(self, is_resting: bool) -> None:
        """Draw nothing while the machine is too slow; the log beside the pictures says so."""
        if is_resting != self._is_resting:
            self._is_resting = is_resting
            self._worker.put(Note(RESTING if is_resting else DRAWING))

    def close(self) -> None:
        """Finish the recording, within 2.5 s.

        Raises UserFacingError, the first time, if not everything could be kept.
        """
        due_s = time.monotonic() + CLOSING_S
        self._worker.close(CLOSING_S)
        has_ended = self._supervisor.stop(max(0.0, due_s - time.monotonic()))
        if not has_ended:
            logger.warning("rerun: %s did not take all data in time; the end is lost", self.address)
        is_incomplete = self._supervisor.incomplete or (self._sink.is_kept and not has_ended)
        if is_incomplete and not self._is_closed:
            self._is_closed = True
            raise UserFacingError(f"{self.address}: the recording is not complete")
        self._is_closed = True

    def _hand_over(self, item: PoseUpdate | Status | Note) -> None:
        match item:
            case PoseUpdate():
                self._send(self._sketcher.of_pose(item))
            case Status():
                self._send([self._sketcher.of_status(item)])
            case Note():
                self._send([item])

    def _finish(self) -> None:
        self._supervisor.expect_end()
        self._send([*self._sketcher.rest(), Finish()])

    def _send(self, messages: Iterable[Message]) -> None:
        for message in messages:
            self._link.send(message, self._sketcher.backdrop)


def open_viewer(
    target: str,
    settings: RerunSettings = RerunSettings(),  # noqa: B008 (frozen)
    ground_truth: TruthSource = no_truth,
    pace: Pace = Pace.REALTIME,
) -> ViewerOutput:
    """Open a target as users write it: serve, connect, connect:HOST:PORT or FILE.rrd.

    Raises what `ViewerOutput` raises, and InputError for anything else.
    """
    for _ in range(ATTEMPTS - 1):
        try:
            return ViewerOutput(sink_of(target, settings), settings, ground_truth, pace)
        except PortTakenError:  # by somebody who was looking for one at the same time
            continue
    return ViewerOutput(sink_of(target, settings), settings, ground_truth, pace)
