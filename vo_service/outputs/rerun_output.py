"""Pictures of what the odometry sees and does, in Rerun, from a thread of their own.

Rerun is optional and large: this module is the only door to it, and loads it when used.
"""

import logging
import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from vo_service.outputs.output import PoseUpdate, Status, TruthSource, no_truth
from vo_service.outputs.rerun_browser import WEB_PORT, Browser, free_port
from vo_service.outputs.rerun_sinks import DATA_PORT, RecordingFile, Sink, Viewer
from vo_service.outputs.worker import DropOldest, Worker

if TYPE_CHECKING:
    from vo_service.outputs.rerun_scene import Scene

logger = logging.getLogger(__name__)

APPLICATION = "kinect-vo"
# Ten pictures a second show motion well and cost a third of thirty.
PICTURE_PERIOD_S = 0.1


class RerunOutput:
    """Shows results in one place; give each place an output of its own.

    Numbers (pose, counts, times) go out for every frame, pictures once in `picture_period_s`. It
    never blocks: results that come faster than Rerun takes them are dropped, oldest first, and
    counted. `ground_truth` is drawn beside the estimate where it is known.

    Raises InputError if Rerun is not installed or the file or address is wrong, UserFacingError
    if a port is taken.
    """

    warning = ""

    def __init__(
        self,
        sink: Sink,
        ground_truth: TruthSource = no_truth,
        picture_period_s: float = PICTURE_PERIOD_S,
    ) -> None:
        self._sink = sink
        self._throttle = Throttle(picture_period_s)
        self._scene = _open_scene(sink, ground_truth)
        self._worker: Worker[PoseUpdate | Status] = Worker(
            "rerun", DropOldest(sink.queue), self._log, self._scene.finish
        )

    @property
    def address(self) -> str:
        """What a person opens to see it."""
        return self._sink.address

    @property
    def dropped(self) -> int:
        """Results that newer ones replaced before they were drawn."""
        return self._worker.dropped

    @property
    def errors(self) -> int:
        """Results that could not be drawn."""
        return self._worker.errors

    def pose(self, update: PoseUpdate) -> None:
        """Draw one result (soon)."""
        self._worker.put(update)

    def status(self, status: Status) -> None:
        """Show a change of state (soon)."""
        self._worker.put(status)

    def close(self) -> None:
        """Finish the recording. A viewer that does not answer is left after a few seconds."""
        if not self._worker.close(self._sink.close_s):
            logger.warning("rerun: %s does not take its data; the end of it is lost", self.address)
        self._sink.close()

    def _log(self, item: PoseUpdate | Status) -> None:
        if isinstance(item, Status):
            self._scene.log_status(item)
            return
        self._scene.log_numbers(item)
        if self._throttle.due(self._sink.clock_s(item)):
            self._scene.log_pictures(item)


class Throttle:
    """Lets something through at most once a period, on whatever clock the caller has."""

    def __init__(self, period_s: float) -> None:
        # A camera's stamps are never exactly even: a frame that is almost due is due.
        self._period_s = 0.9 * period_s
        self._last_s = float("-inf")

    def due(self, now_s: float) -> bool:
        """True if the period has passed, or the clock was set back."""
        if 0.0 <= now_s - self._last_s < self._period_s:
            return False
        self._last_s = now_s
        return True


def open_rerun(target: str, ground_truth: TruthSource = no_truth) -> RerunOutput:
    """Open a target as users write it: serve, connect, connect:HOST:PORT or FILE.rrd.

    Raises what `RerunOutput` raises, and InputError for anything else.
    """
    return RerunOutput(sink_of(target), ground_truth)


def sink_of(target: str) -> Sink:
    """The place that a target names. Raises InputError if it names none."""
    if target == "serve":
        return Browser(free_port(DATA_PORT), free_port(WEB_PORT))
    if target == "connect":
        return Viewer()
    if target.startswith("connect:"):
        return Viewer(f"rerun+http://{target.removeprefix('connect:')}/proxy")
    if target.endswith(".rrd"):
        return RecordingFile(Path(target))
    raise InputError(f"rerun target {target!r}: use serve, connect, connect:HOST:PORT or FILE.rrd")


def prepare_rerun() -> None:
    """Before it is imported. Raises InputError if it is not installed."""
    if find_spec("rerun") is None:
        raise InputError("Rerun is not installed: pip install 'kinect-vo[rerun]'")
    # Rerun reads this when it is loaded, and would tell about its ports and threads otherwise.
    os.environ.setdefault("RUST_LOG", "error")


def _open_scene(sink: Sink, ground_truth: TruthSource) -> "Scene":
    prepare_rerun()
    scene = import_module("vo_service.outputs.rerun_scene")
    opened: Scene = scene.open_scene(APPLICATION, sink, ground_truth)
    return opened
