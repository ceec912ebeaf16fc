"""One run in a process of its own, where it may crash or hang without harm to the others."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.errors import UserFacingError
from drivers.isolation.messages import LogLine
from drivers.isolation.process import ChildProcess, Program
from vo_service.runs.messages import Compiled, Job, Preparing, Progress, Word
from vo_service.runs.run import Outcome, RunState

PROGRAM = Program("vo_service.runs.child", "run")
TICK_S = 0.25
ENDING_S = 5.0


def run_in_child(
    job: Job,
    limit_s: float,
    tell: Callable[[Preparing | Progress], None],
    stop: threading.Event,
) -> Outcome:
    """Run to the end, for at most `limit_s`; a set `stop` ends it at once, without a result.

    Where kernels have to be compiled first, that is done in a process of its own.
    Raises UserFacingError if no process can be started.
    """
    last_word = _in_process(job, limit_s, tell, stop)
    if isinstance(last_word, Compiled):
        last_word = _in_process(replace(job, may_end_compiled=False), limit_s, tell, stop)
    assert isinstance(last_word, Outcome)
    return last_word


def _in_process(
    job: Job,
    limit_s: float,
    tell: Callable[[Preparing | Progress], None],
    stop: threading.Event,
) -> Outcome | Compiled:
    """The last word of a process, or how it ended without one."""
    try:
        with ChildProcess(PROGRAM, (), ENDING_S) as child:
            child.tell(job)
            last_word = _attend(child, limit_s, tell, stop)
    except OSError as error:
        raise UserFacingError(
            f"a process for the run cannot be started: {error.strerror}; see to memory and limits"
        ) from error
    return last_word or Outcome(RunState.CRASHED, trouble=child.ending)


def _attend(
    child: ChildProcess,
    limit_s: float,
    tell: Callable[[Preparing | Progress], None],
    stop: threading.Event,
) -> Outcome | Compiled | None:
    """Listen until it has its last word; None if it ended without one."""
    due_s = time.monotonic() + limit_s
    while not stop.is_set():
        left_s = due_s - time.monotonic()
        if left_s <= 0:
            child.kill()
            trouble = f"took longer than {limit_s:g} s (--time-limit)"
            return Outcome(RunState.TIMED_OUT, trouble=trouble)
        try:
            word: Word | None = child.receive(min(TICK_S, left_s))
        except EOFError:
            return None
        match word:
            case Outcome() | Compiled():
                return word
            case LogLine(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
            case Preparing() | Progress():
                tell(word)
    child.kill()
    return Outcome(RunState.NOT_RUN, trouble="stopped before its end")
