"""The flight recorder as the service sees it: an output that remembers the last seconds."""

import json
import logging
import time
from collections.abc import Mapping
from pathlib import Path

from vo_service.outputs.worker import DropOldest, Worker
from vo_service.recorder.clerk import Clerk
from vo_service.recorder.loss import LossWatch, NoLossWatch
from vo_service.recorder.memory import Memory, TimedStatus
from vo_service.recorder.messages import Job
from vo_service.settings import MEGABYTE, RecorderSettings
from vo_service.types import CommandError, ErrorCode, PoseUpdate, Status

logger = logging.getLogger(__name__)

_MOST_WAITING = 8
_WORKER_S = 1.0


class FlightRecorder:
    """Remembers the last seconds in memory that outlives this process.

    Frames are packed on a thread of its own. A second process writes them to disk: when tracking
    is lost, when told to, or when this process ends without `close`.
    """

    def __init__(
        self, settings: RecorderSettings, state: Path, about: Mapping[str, object]
    ) -> None:
        """Start. Raises OSError if the memory cannot be had.

        state  folder in which incidents and recordings have theirs
        about  of the service: goes into each incident as JSON
        """
        self._memory = Memory(settings.seconds, settings.max_mb)
        self._no_memory = ""
        self._saves_losses = settings.save_on_loss
        self._loss = _loss_watch(self._saves_losses)
        self._is_closed = False
        self._clerk = Clerk(
            Job(
                frames=self._memory.frames.memory,
                statuses=self._memory.statuses.memory,
                seconds=settings.seconds,
                incidents=settings.folder or state / "incidents",
                total_bytes=settings.total_mb * MEGABYTE,
                recordings=state / "recordings",
                about=json.dumps(about, default=str),
                log_level=logging.getLogger().getEffectiveLevel(),
            )
        )
        self._worker: Worker[PoseUpdate | TimedStatus] = Worker(
            "recorder", DropOldest(_MOST_WAITING), self._handle, lambda: None
        )

    @property
    def warning(self) -> str:
        """What is wrong with it, in one clause."""
        return self._no_memory or self._clerk.warning

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        return self._clerk.recording

    @property
    def is_up(self) -> bool:
        """Whether its process takes orders."""
        return self._clerk.is_up

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return self._clerk.is_saving

    @property
    def remembered(self) -> int:
        """Frames that have ever been copied into its memory."""
        return self._memory.frames.count

    @property
    def missed(self) -> int:
        """Frames and statuses that newer ones replaced before they were remembered."""
        return self._worker.dropped

    def pose(self, update: PoseUpdate) -> None:
        """Remember a frame and what was said of it (soon)."""
        self._worker.put(update)
        now_s = time.monotonic()
        self._loss.see(update.state, now_s)
        self._save_loss_if(self._loss.is_due(now_s))

    def status(self, status: Status) -> None:
        """Remember a status (soon)."""
        self._worker.put(TimedStatus.now(status))
        self._save_loss_if(self._loss.is_due(time.monotonic()))

    def save(self, reason: str) -> str:
        """As `Recorder`."""
        if not self._memory.frames.count:
            raise CommandError(ErrorCode.NOT_POSSIBLE, "no frame has come yet")
        return self._clerk.save(reason)

    def start_recording(self, name: str) -> str:
        """As `Recorder`."""
        return self._clerk.start_recording(name, self._memory.frames.count)

    def stop_recording(self) -> str:
        """As `Recorder`."""
        return self._clerk.stop_recording(self._memory.frames.count)

    def configure(self, settings: RecorderSettings) -> None:
        """As `Recorder`."""
        if settings.save_on_loss != self._saves_losses:  # else a loss that is due is still written
            self._saves_losses = settings.save_on_loss
            self._loss = _loss_watch(self._saves_losses)
        self._clerk.keep_at_most(settings.total_mb * MEGABYTE)

    def close(self) -> None:
        """Forget everything; a loss that is not written yet still is, and so is a recording."""
        if self._is_closed:
            return
        self._is_closed = True
        has_finished = self._worker.close(_WORKER_S)
        self._save_loss_if(self._loss.is_pending)
        self._clerk.close()
        if has_finished:
            self._memory.close()

    def _handle(self, item: PoseUpdate | TimedStatus) -> None:
        """Body of the worker's thread: one item."""
        try:
            self._memory.put(item, self._worker.dropped)
            self._no_memory = ""
        except OSError as error:
            self._no_memory = f"recorder: no memory for the last frames: {error.strerror}"

    def _save_loss_if(self, is_time: bool) -> None:
        if not is_time:
            return
        try:
            self._clerk.save("lost")
        except CommandError as error:
            logger.warning("recorder: a loss of tracking is not written: %s", error)


def _loss_watch(is_wanted: bool) -> LossWatch | NoLossWatch:
    return LossWatch() if is_wanted else NoLossWatch()
