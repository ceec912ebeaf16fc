"""Compiling or loading kernels before the first frame, with progress."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

import cv2

from drivers.core.errors import UserFacingError
from drivers.core.files import cache_folder, kernel_folder
from drivers.core.jit import interruptible
from vo_service.config import Config
from vo_service.odometry.warm_up import warm_up
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal

T = TypeVar("T")


def prepare_kernels(config: Config, terminal: Terminal, stop: StopSignal) -> float:
    """Compile or load the method's kernels, as `prepared` does; returns the seconds it took."""
    return run_warm_up(partial(warm_up, config.odometry.method), terminal, stop)


def prepare_loop_closure(terminal: Terminal, stop: StopSignal) -> float:
    """The same for what knows places again."""
    from vo_service.slam.loop_closure.warm_up import warm_up_loop_closure

    taken_s = run_warm_up(warm_up_loop_closure, terminal, stop)
    with suppress(OSError):  # it is done again next time
        _loops_mark().touch()
    return taken_s


def loops_are_prepared() -> bool:
    """Whether `prepare_loop_closure` has been done before, with this source.

    The service needs it no more then: it is its map's process that loads the kernels.
    """
    return _loops_mark().exists()


def _loops_mark() -> Path:
    return kernel_folder() / "loops-are-prepared"


def run_warm_up(
    warm_up_function: Callable[[Callable[[str], None]], T], terminal: Terminal, stop: StopSignal
) -> T:
    """Do what compiles or loads kernels, with progress: `work` gets whom to tell its stages.

    Raises KeyboardInterrupt, between two kernels, when asked to stop; UserFacingError if what was
    compiled cannot be kept.
    """
    # One thread: the service's latency must not depend on who else needs the other core.
    cv2.setNumThreads(1)
    label = "preparing the numeric kernels (longer the first time)"
    with interruptible(stop.check), terminal.busy(label) as busy:
        try:
            result = warm_up_function(busy.set_detail)
        except OSError as error:
            raise UserFacingError(
                f"{cache_folder()}: the compiled kernels cannot be kept: {error.strerror}; free "
                "some space, or name a folder elsewhere in XDG_CACHE_HOME"
            ) from error
        stop.check()
    return result
