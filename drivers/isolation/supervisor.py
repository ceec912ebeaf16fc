"""Keeps a driver's process running: starts it, watches the clock, kills it, starts it again."""

import logging
import os
import threading
import time
from collections import deque
from contextlib import suppress

from drivers.camera import CameraCounters, CameraState, Condition, EndOfStream
from drivers.errors import CameraLostError
from drivers.isolation.limits import BackOff, Phase
from drivers.isolation.messages import Ended, Facts, Job, LogLine, Report, Task, Word
from drivers.isolation.process import DRIVER, ChildProcess
from drivers.isolation.ring import RingReader
from drivers.isolation.wishes import Wish

_log = logging.getLogger(__name__)


class Supervisor:
    """A thread that owns the process, so that it is watched even while nobody reads frames.

    What is known of the camera can be asked for at any time, from any thread.
    """

    condition: Condition
    facts: Facts
    ending: Exception | None  # why no frame will follow

    def __init__(self, task: Task, ring: RingReader) -> None:
        """The ring must be open from before `start` until after `stop`."""
        self._task, self._ring = task, ring
        self._lock = threading.Lock()
        self._thread = threading.Thread()
        self._is_done = threading.Event()
        self._is_done.set()
        self._wishes: dict[type[Wish], Wish] = {}  # for every process from now on
        self._unsaid: deque[Wish] = deque()  # to the process that runs
        self._forget()

    def start(self) -> None:
        """Begin."""
        self._forget()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name="driver-supervisor", daemon=True)
        self._is_done.clear()
        self._thread.start()

    def wait_until_open(self) -> None:
        """Until the camera is open for the first time. Raises what kept it from that."""
        self._is_settled.wait()
        if self.ending is not None and not self._was_open:
            raise self.ending

    def stop(self) -> None:
        """End the process: in order if it can, by force if not. Safe to call at any time.

        An interrupted call does no harm: the thread brings it to an end.
        """
        self._stopping.set()
        with self._lock:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)
        # Not `join` at once: a thread whose `join` was interrupted counts as ended in CPython 3.11.
        self._is_done.wait()
        if self._thread.is_alive():
            self._thread.join()

    def ask(self, wish: Wish) -> bool:
        """Pass a wish on, without waiting; False if the camera is not open to hear it now.

        It is then done when the camera is opened, as it is again whenever the camera is.
        """
        with self._lock:
            self._wishes[type(wish)] = wish
            if self._wake < 0:
                return False
            self._unsaid.append(wish)
            os.eventfd_write(self._wake, 1)
            return self._phase in (Phase.STARTING, Phase.STREAMING)

    @property
    def counters(self) -> CameraCounters:
        """What the camera counted, in all processes since `start`."""
        before, now = self._counted
        return before + now

    def _forget(self) -> None:
        self.condition, self.facts, self.ending = Condition(CameraState.OPENING), Facts(), None
        self._counted = CameraCounters(), CameraCounters()  # earlier processes, and this one
        self._phase, self._was_open = Phase.LAUNCHING, False
        self._back_off = BackOff(self._task.limits)
        self._is_settled, self._stopping = threading.Event(), threading.Event()
        self._wake = -1

    def _run(self) -> None:
        """Body of the thread: one process after another. Errors in it reach the reader."""
        try:
            while not self._stopping.is_set() and self.ending is None:
                self._run_process()
                if self.ending is None:
                    self._stopping.wait(self._back_off.next_s())
        except Exception as error:
            self._finish(error)
        finally:
            self._is_settled.set()
            with self._lock:
                os.close(self._wake)
                self._wake = -1
            self._is_done.set()

    def _run_process(self) -> None:
        """From the start of a process until nothing is left of it."""
        self._phase = Phase.LAUNCHING
        if self._task.is_live:
            self._ring.grant()
        try:
            with ChildProcess(DRIVER, self._ring.ends.all, self._task.limits.closing_s) as process:
                process.tell(self._job())
                trouble = self._attend(process)
        except OSError as error:
            self._note_trouble(f"cannot be started: {error.strerror}")
        else:
            self._note_trouble(trouble or process.ending)
        self._counted = self.counters, CameraCounters()

    def _job(self) -> Job:
        level = logging.getLogger().getEffectiveLevel()
        with self._lock:
            self._unsaid.clear()
            wishes = tuple(self._wishes.values())
        return Job(self._task, self._ring.ends, self.condition, wishes, level)

    def _attend(self, process: ChildProcess) -> str:
        """Listen until it ends, or must: returns what is wrong with it if it had to be killed."""
        due_s = time.monotonic() + self._silence_s()
        while not self._stopping.is_set():
            try:
                word: Word | None = process.receive(max(0.0, due_s - time.monotonic()), self._wake)
            except EOFError:
                return ""
            self._pass_wishes_on(process)
            if word is not None:
                self._hear(word)
            if isinstance(word, Report):  # a log line is no sign of life: other threads log too
                due_s = time.monotonic() + self._silence_s()
            elif time.monotonic() >= due_s:
                process.kill()
                return f"hung while {self._phase}: no answer for {self._silence_s():g} s"
        if self._phase in (Phase.LAUNCHING, Phase.WAITING):
            process.kill()  # there is no camera to close
        process.tell(None)
        return ""

    def _pass_wishes_on(self, process: ChildProcess) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        while self._unsaid:
            process.tell(self._unsaid.popleft())

    def _silence_s(self) -> float:
        return self._task.limits.silence_s(self._phase)

    def _hear(self, word: Word) -> None:
        match word:
            case Report(phase, condition, counters):
                self._phase, self.condition = phase, condition
                self._counted = self._counted[0], counters
                if phase is Phase.STREAMING:
                    self._back_off.reset()
            case Facts():
                self.facts, self._was_open = word, True
                self._is_settled.set()
            case Ended(error):
                self._finish(error or EndOfStream())
            case LogLine(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)

    def _note_trouble(self, trouble: str) -> None:
        """Say what became of a process that nobody told to end."""
        if self.ending is not None or self._stopping.is_set():
            return
        text = f"the driver {trouble}"
        _log.info("%s", text)
        if self._task.is_live:
            self._ring.reset()
            was_open = self._phase in (Phase.STARTING, Phase.STREAMING, Phase.CLOSING)
            state = CameraState.LOST if was_open else CameraState.OPENING
            self.condition = Condition(state, text)
        else:
            self._finish(CameraLostError(f"{text}; open the recording again"))

    def _finish(self, ending: Exception) -> None:
        """No frame will follow those in the ring."""
        self.ending = ending
        self._ring.finish()
        self._is_settled.set()
