"""Keeps the viewer's process running while there is somewhere to show pictures."""

import logging
import threading
import time

from drivers.errors import UserFacingError
from drivers.isolation.limits import BackOff, TimeLimits
from drivers.isolation.messages import LogLine
from drivers.isolation.process import ChildProcess, Program
from vo_service.viewer.link import Link
from vo_service.viewer.messages import Backdrop, Ended, Finish, Health, Job, Ready, Word
from vo_service.viewer.notices import Notices
from vo_service.viewer.presence import ANSWER_S, PERIOD_S, Watch

PROGRAM = Program("vo_service.viewer.child", "viewer")
# Python, OpenCV and Rerun, from a slow disk, with a third of a processor.
LAUNCHING_S = 60.0
# A process that says nothing for so long is killed.
SILENCE_S = 10.0
TICK_S = 0.25
# For a process that was killed, until nothing is left of it.
ENDING_S = 0.3
# Waits before a process that ended is started again.
LIMITS = TimeLimits(first_retry_s=0.5, longest_retry_s=30.0)
# One that ran for so long has not failed at once.
RAN_WELL_S = 30.0


class Supervisor:
    """A thread that owns the process: starts it, watches it, starts it again.

    refusal     why the first process could not be, if it could not
    incomplete  what could not be kept, "" if everything was
    """

    def __init__(self, job: Job, link: Link, notices: Notices) -> None:
        self._job, self._link, self._notices = job, link, notices
        self._watch = Watch(job.sink.presence())
        self._settled, self._stopping = threading.Event(), threading.Event()
        self._must_end = threading.Event()
        self.refusal: UserFacingError | None = None
        self.incomplete = ""
        self._thread = threading.Thread(target=self._run, name="viewer-supervisor", daemon=True)
        self._thread.start()

    def wait_until_settled(self, timeout_s: float) -> None:
        """Until pictures are drawn, or it is known why not. Raises what makes it impossible."""
        self._settled.wait(timeout_s)
        self._settled.set()
        if self.refusal is not None:
            raise self.refusal

    def expect_end(self) -> None:
        """The process is about to be told to end: that is no trouble."""
        self._stopping.set()

    def stop(self, timeout_s: float) -> bool:
        """Wait for the process to end, as it was told to. False if it had to be killed."""
        self.expect_end()
        self._thread.join(timeout_s)
        self._must_end.set()
        has_ended = not self._thread.is_alive()
        self._thread.join(TICK_S + ANSWER_S)
        return has_ended

    def _run(self) -> None:
        """Body of the thread: one process after another, while there is a viewer."""
        back_off = BackOff(LIMITS)
        while not self._stopping.is_set() and self.refusal is None:
            if not self._watch.begin():
                self._notices.tell(self._absence())
                self._settled.set()
                self._stopping.wait(PERIOD_S)
                continue
            begin_s = time.monotonic()
            trouble = self._run_process()
            if not self._stopping.is_set() and self.refusal is None:
                self._notices.tell(trouble)
                if time.monotonic() - begin_s > RAN_WELL_S:
                    back_off.reset()
                self._stopping.wait(back_off.next_s())
        self._watch.end()

    def _absence(self) -> str:
        return f"no viewer answers at {self._job.sink.address}; start one with: rerun"

    def _run_process(self) -> str:
        """From the start of a process until nothing is left of it; returns why it ended."""
        try:
            with ChildProcess(PROGRAM, (), ENDING_S) as process:
                process.tell(self._job)
                trouble = self._attend(process)
                self._link.cut()
        except OSError as error:
            return f"the viewer's process cannot be started: {error.strerror}; trying again"
        return trouble or f"the viewer's process {process.ending}; starting it again"

    def _attend(self, process: ChildProcess) -> str:
        """Listen until it ends, or must; returns why, if that is known."""
        due_s = time.monotonic() + LAUNCHING_S
        said = ""
        while (trouble := self._trouble(due_s)) == "":
            try:
                word: Word | None = process.receive(TICK_S)
            except EOFError:
                return said
            if word is not None:
                due_s = time.monotonic() + SILENCE_S
                said = self._hear(word, process)
        process.kill()
        return trouble

    def _trouble(self, due_s: float) -> str:
        """Why the process must end now; "" if it need not."""
        if self._must_end.is_set():
            return "the viewer's process was stopped"
        if time.monotonic() >= due_s:
            return "the viewer's process hung; starting it again"
        return self._absence() if self._watch.has_gone() else ""

    def _hear(self, word: Word, process: ChildProcess) -> str:
        """Returns why the process will end, if it says so."""
        match word:
            case Ready():
                self._link.connect(process)
                self._settled.set()
                if self._stopping.is_set():  # it was told to nobody
                    self._link.send(Finish(), Backdrop())
            case Health(trouble, incomplete) if self._link.is_connected:
                self.incomplete = self.incomplete or incomplete
                self._notices.tell(trouble)
            case Ended(error):
                if not self._settled.is_set():  # then it is the caller's affair
                    self.refusal = error
                    self._settled.set()
                return str(error)
            case LogLine(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
        return ""
