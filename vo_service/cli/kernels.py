"""The kernels that a command needs, compiled or loaded before it begins.

OpenCV is imported with the kernels, because most commands need neither.
"""

from collections.abc import Callable, Sequence
from functools import partial

from drivers.core import UserFacingError
from drivers.core.folders import cache_folder
from drivers.core.jit import interruptible
from vo_service.config import Config
from vo_service.kernels.compilation import ensure_compiled
from vo_service.kernels.loading import load_kernels
from vo_service.odometry.registry import METHODS, OWN_METHODS
from vo_service.odometry.warm_up import warm_up
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal


def prepare_kernels(config: Config, terminal: Terminal, stop: StopSignal) -> None:
    """Compile or load the kernels of the configured method. Raises as `run_warm_up`."""
    compile_kernels([config.odometry.method], terminal, stop)
    load_kernels(config.odometry.method, stop.event)
    stop.check()


def compile_kernels(parts: Sequence[str], terminal: Terminal, stop: StopSignal) -> None:
    """Compile the kernels of parts if they are not in the cache; otherwise as `prepare_kernels`.

    A method that is a plug-in is run on generated frames, since its kernels are not known.
    """
    run_warm_up(partial(ensure_compiled, parts), terminal, stop)
    for part in parts:
        if part in METHODS and part not in OWN_METHODS:
            run_warm_up(partial(warm_up, part), terminal, stop)


# The part of a camera that has kernels, by its source.
CAMERA_PARTS = {"freenect": "Kinect", "synthetic": "virtual Kinect"}


def first_parts(config: Config, source: str) -> list[str]:
    """List the parts whose kernels the first pose needs; other processes compile their own."""
    parts = [config.odometry.method]
    if config.has_recorder or config.map.enabled:
        parts += ["frame packing"]
    if config.scan.enabled:
        parts += ["scan"]
    return [*parts, CAMERA_PARTS[source]] if source in CAMERA_PARTS else parts


def run_warm_up(
    warm_up_function: Callable[[Callable[[str], None]], object],
    terminal: Terminal,
    stop: StopSignal,
) -> None:
    """Run a warm-up function, with progress.

    Args:
        warm_up_function: Compiles or loads kernels; it calls its argument with each stage.
        stop: Stop request; checked between two kernels, and with each report of the progress.

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

        def report(detail: str) -> None:
            stop.check()
            busy.set_detail(detail)

        try:
            warm_up_function(report)
        except OSError as error:
            raise UserFacingError(
                f"{cache_folder()}: the compiled kernels cannot be written: {error.strerror}; free "
                "some space, or set XDG_CACHE_HOME to another folder"
            ) from error
        stop.check()
