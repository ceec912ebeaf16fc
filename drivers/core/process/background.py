"""Setup of a background process: lower priority than everything else on the robot."""

import os
import signal
from contextlib import suppress
from pathlib import Path

import cv2

from drivers.core.process.parent_connection import ignore_terminal_signals

NICE = 10
# The service can run without such a process, so it is killed first when memory runs out.
OOM_SCORE_ADJ = 800
# A terminal, systemd or its watchdog may send these to every process when the service stops.
_IGNORED_SIGNALS = (signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)


def configure_background_process() -> None:
    """Ignore the service's signals, lower the priority, and make new files private."""
    ignore_terminal_signals(*_IGNORED_SIGNALS)
    os.umask(0o077)  # other users must not read images of the robot's surroundings
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICE)
    set_oom_score(OOM_SCORE_ADJ)
    cv2.setNumThreads(1)


def set_oom_score(score: int) -> None:
    """Set how readily the kernel kills this process when memory runs out: at most 1000."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(score))
