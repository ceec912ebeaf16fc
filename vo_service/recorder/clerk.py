"""What is being written by the recorder's process, and what went wrong with it."""

import logging
import threading
import time
from dataclasses import replace
from re import fullmatch

from drivers.isolation.messages import LogLine
from vo_service.background.keeper import Helper, Keeper
from vo_service.background.trouble import Trouble
from vo_service.recorder.incident_folder import incident_name
from vo_service.recorder.messages import (
    Facts,
    IncidentWritten,
    Job,
    KeepAtMost,
    RecordingEnded,
    SaveIncident,
    StartRecording,
    StopRecording,
    Word,
)
from vo_service.types import NAME_PATTERN, CommandError, ErrorCode

logger = logging.getLogger(__name__)

NAME = "recorder"
HELPER = Helper("vo_service.recorder.child", NAME)


class Clerk:
    """Passes on what is asked for, at once; refuses what cannot be. Safe from any thread."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._lock = threading.Lock()
        self._saving = ""  # name of the incident that is being written
        self._taken: frozenset[str] = frozenset()
        self._missed = 0
        self._incidents, self._recordings, self._folders = (Trouble(NAME) for _ in range(3))
        self._process_trouble = ""
        self.recording = ""
        self._keeper = Keeper(HELPER, job, self._hear, self._died)

    @property
    def is_up(self) -> bool:
        """Whether the process takes orders."""
        return self._keeper.is_up

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return bool(self._saving)

    @property
    def warning(self) -> str:
        """One clause; "" while all is well."""
        if self._keeper.is_up and self._keeper.is_silent:
            return "recorder: its process does not answer; is the disk hung?"
        if self.recording and self._missed:
            return f"recorder: {self.recording} lacks {self._missed} frames, the disk is too slow"
        failed = "; ".join(filter(None, (self._incidents.text, self._recordings.text)))
        trouble = failed or self._folders.text or self._process_trouble
        return f"recorder: {trouble}" if trouble else ""

    def save(self, reason: str) -> str:
        """Write an incident; its folder. Raises CommandError if that cannot be."""
        with self._lock:
            self._check_is_up()
            if self._saving:
                raise _not_possible(f"an incident is being written already: {self._saving}")
            self._saving = incident_name(reason, time.time())
            self._keeper.tell(SaveIncident(self._saving, reason))
            return str(self._job.incidents / self._saving)

    def start_recording(self, name: str, first: int) -> str:
        """Record from frame `first` of the ring on; the folder. Raises CommandError if not."""
        if not fullmatch(NAME_PATTERN, name):
            raise CommandError(
                ErrorCode.BAD_REQUEST,
                "a recording's name is up to 64 letters, digits, dots, dashes and underscores",
            )
        with self._lock:
            self._check_is_up()
            if self.recording:
                raise _not_possible(f"{self.recording} is being recorded; stop that first")
            if name in self._taken:
                raise _not_possible(f"there is a recording {name!r} already; give another name")
            self._taken, self._missed = self._taken | {name}, 0
            self._recordings.note("")
            self.recording = str(self._job.recordings / name)
            self._keeper.tell(StartRecording(name, first))
            return self.recording

    def stop_recording(self, end: int) -> str:
        """End it before frame `end`; the folder. Raises CommandError if nothing is recorded."""
        with self._lock:
            folder, self.recording = self.recording, ""
            if not folder:
                raise _not_possible("nothing is being recorded")
            self._keeper.tell(StopRecording(end))
            return folder

    def keep_at_most(self, total_bytes: int) -> None:
        """Of incidents, from now on."""
        self._keeper.job = replace(self._job, total_bytes=total_bytes)
        self._keeper.tell(KeepAtMost(total_bytes))

    def close(self) -> None:
        """End what is being written, as far as there is time; the process goes on by itself."""
        self._keeper.close()

    def _check_is_up(self) -> None:
        if not self._keeper.is_up or self._keeper.is_silent:
            raise _not_possible("the recorder's process does not answer; try again in a moment")

    def _hear(self, word: Word) -> None:
        match word:
            case Facts(recordings, missed, trouble):
                self._taken, self._missed = recordings, missed
                self._process_trouble = ""
                self._folders.note(trouble)
            case IncidentWritten(folder, frames, trouble):
                self._saving = ""
                if not trouble:
                    logger.warning("recorder: the last %d frames are in %s", frames, folder)
                self._incidents.note(trouble)
            case RecordingEnded(folder, frames, missed, trouble):
                with self._lock:  # the next one may have begun
                    if self.recording == str(folder):
                        self.recording = ""
                logger.info("recorder: %s: %d frames, %d missed", folder, frames, missed)
                self._recordings.note(trouble)
            case LogLine(level, name, text):
                logging.getLogger(name).log(level, "recorder: %s", text)

    def _died(self) -> None:
        with self._lock:
            saving, recording = self._saving, self.recording
            self._saving = self.recording = ""
        self._process_trouble = "its process ended and is started again"
        logger.warning("recorder: %s", self._process_trouble)
        for cut_off, trouble in ((saving, self._incidents), (recording, self._recordings)):
            if cut_off:
                trouble.note(f"its process ended and cut off {cut_off}")


def _not_possible(reason: str) -> CommandError:
    return CommandError(ErrorCode.NOT_POSSIBLE, reason)
