"""The kernels that a command needs, compiled or loaded before it begins.

OpenCV is imported with the kernels, because most commands need neither.
"""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

from drivers.core import UserFacingError
from drivers.core.folders import cache_folder, kernel_folder
from drivers.core.jit import interruptible
from vo_service.config import Config
from vo_service.odometry.warm_up import warm_up
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal

T = TypeVar("T")


def prepare_kernels(config: Config, terminal: Terminal, stop: StopSignal) -> float:
    """Compile or load the kernels of the configured method.

    Returns:
        Time taken, s.

    Raises:
        KeyboardInterrupt: If a stop is requested.
        UserFacingError: If the compiled kernels cannot be written.
    """
    return run_warm_up(partial(warm_up, config.odometry.method), terminal, stop)


def prepare_loop_closure(terminal: Terminal, stop: StopSignal) -> float:
    """Compile or load the kernels of loop closure; otherwise as `prepare_kernels`."""
    from vo_service.slam.synchronous_loop_closure import warm_up_loop_closure

    taken_s = run_warm_up(warm_up_loop_closure, terminal, stop)
    with suppress(OSError):  # without the mark, it is repeated next time
        _loops_mark().touch()
    return taken_s


def loops_are_prepared() -> bool:
    """Whether `prepare_loop_closure` has run before with this source.

    If so, the service skips it: only the mapper's process loads these kernels.
    """
    return _loops_mark().exists()


def _loops_mark() -> Path:
    return kernel_folder() / "loops-are-prepared"


def run_warm_up(
    warm_up_function: Callable[[Callable[[str], None]], T], terminal: Terminal, stop: StopSignal
) -> T:
    """Run a warm-up function, with progress.

    Args:
        warm_up_function: Compiles or loads kernels; it calls its argument with each stage.
        stop: Stop request; checked between two kernels.

    Raises:
        KeyboardInterrupt: If a stop is requested.
        UserFacingError: If the compiled kernels cannot be written.
    """
    import cv2

    # One thread: the service's latency must not depend on the load of the other cores.
    cv2.setNumThreads(1)
    label = "preparing the numeric kernels (longer the first time)"
    # LLVM calls Python when it loads a kernel: an exception there would crash the process.
    with stop.without_exceptions(), interruptible(stop.check), terminal.busy(label) as busy:
        try:
            result = warm_up_function(busy.set_detail)
        except OSError as error:
            raise UserFacingError(
                f"{cache_folder()}: the compiled kernels cannot be written: {error.strerror}; free "
                "some space, or set XDG_CACHE_HOME to another folder"
            ) from error
        stop.check()
    return result
