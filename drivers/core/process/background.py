"""How a process in the background begins: it gives way to everything else on the robot."""

import os
import signal
from contextlib import suppress
from pathlib import Path

import cv2

from drivers.core.process.parent_connection import ignore_terminal_signals

NICE = 10
# The service can do without such a process, so that is the one to end where memory runs out.
OOM_SCORE_ADJ = 800
# What else a terminal, systemd or its watchdog may send to every process when the service stops.
_IGNORED_SIGNALS = (signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)


def configure_background_process() -> None:
    """Leave signals to the service and the processor to others; write what others may not read."""
    ignore_terminal_signals(*_IGNORED_SIGNALS)
    os.umask(0o077)  # pictures of where the robot was are nobody else's business
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICE)
    set_oom_score(OOM_SCORE_ADJ)
    cv2.setNumThreads(1)


def set_oom_score(score: int) -> None:
    """How readily the kernel may end this process where memory runs out: at most 1000."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(score))
