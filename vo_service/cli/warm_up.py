"""``kinect-vo warm-up``, and the same at the start of other commands: compile the kernels."""

import argparse
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

import cv2

from drivers.core import UserFacingError
from drivers.core.files import cache_folder, kernel_folder
from drivers.core.jit import interruptible
from vo_service.cli.options import add_config_options, load_config
from vo_service.config import Config
from vo_service.odometry.registry import warm_up
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal

EPILOG = """\
examples:
  kinect-vo warm-up                     as the user who will run kinect-vo

The kernels are cached in $CACHE_DIRECTORY (systemd), else in $XDG_CACHE_HOME/kinect-vo, else in
~/.cache/kinect-vo. $NUMBA_CACHE_DIR names another folder. Kernels that set-up has compiled are
copied from there.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_config_options(parser)


def run(args: argparse.Namespace) -> int:
    """Compile the kernels of the configured parts, or load them from the cache.

    Raises:
        UserFacingError: If the configuration is not valid, or if the kernels cannot be written.
    """
    # Imported here because the other users of this file do not need a map.
    from vo_service.reconstruction import warm_up_reconstruction

    config = load_config(args)
    terminal = Terminal()
    with stop_on_signals() as stop:
        taken_s = prepare_kernels(config, terminal, stop)
        if config.map.enabled:
            taken_s += run_warm_up(warm_up_reconstruction, terminal, stop)
            taken_s += prepare_loop_closure(terminal, stop)
        if config.recorder.enabled or config.map.enabled:
            taken_s += run_warm_up(_warm_up_depth_packing, terminal, stop)
        if config.camera.source == "synthetic":
            taken_s += run_warm_up(_warm_up_renderer, terminal, stop)
    maps = " and of maps" if config.map.enabled else ""
    print(f"the kernels of {config.odometry.method}{maps} are ready ({taken_s:.1f} s)")
    return 0


def _warm_up_depth_packing(on_progress: Callable[[str], None]) -> float:
    from vo_service.frame_record import compile_kernels

    begin_s = time.monotonic()
    on_progress("depth packing")
    compile_kernels()
    return time.monotonic() - begin_s


def _warm_up_renderer(on_progress: Callable[[str], None]) -> float:
    from drivers.synthetic.renderer import warm_up_renderer

    on_progress("virtual Kinect")
    return warm_up_renderer()


T = TypeVar("T")


def prepare_kernels(config: Config, terminal: Terminal, stop: StopSignal) -> float:
    """Compile or load the kernels of the configured method.

    Args:
        config: Gives the method.
        terminal: Shows progress.
        stop: Stop request.

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
        terminal: Shows progress.
        stop: Stop request; checked between two kernels.

    Raises:
        KeyboardInterrupt: If a stop is requested.
        UserFacingError: If the compiled kernels cannot be written.
    """
    # One thread: the service's latency must not depend on the load of the other cores.
    cv2.setNumThreads(1)
    label = "preparing the numeric kernels (longer the first time)"
    with interruptible(stop.check), terminal.busy(label) as busy:
        try:
            result = warm_up_function(busy.set_detail)
        except OSError as error:
            raise UserFacingError(
                f"{cache_folder()}: the compiled kernels cannot be written: {error.strerror}; free "
                "some space, or set XDG_CACHE_HOME to another folder"
            ) from error
        stop.check()
    return result
