"""``kinect-vo warm-up``: compile the kernels."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from vo_service.cli.kernels import prepare_kernels, prepare_loop_closure, run_warm_up
from vo_service.cli.options import ConfigFile, Method, Timing, load_config
from vo_service.cli.request import CommandRequest
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal

EPILOG = """\
examples:
  kinect-vo warm-up                     as the user who will run kinect-vo

The kernels are cached in $CACHE_DIRECTORY (systemd), else in $XDG_CACHE_HOME/kinect-vo, else in
~/.cache/kinect-vo. $NUMBA_CACHE_DIR names another folder. Kernels that set-up has compiled are
copied from there.
"""


@dataclass(frozen=True, kw_only=True)
class WarmUpRequest(CommandRequest):
    """The parts whose kernels are compiled."""

    config: ConfigFile = None
    method: Method = None
    timing: Timing = None


def run(request: WarmUpRequest) -> int:
    """Compile the kernels of the configured parts, or load them from the cache.

    Raises:
        UserFacingError: If the configuration is not valid, or if the kernels cannot be written.
    """
    # Imported here because `kinect-vo warm-up --help` does not need it.
    from vo_service.reconstruction.warm_up import warm_up_reconstruction

    config = load_config(request.config, request)
    terminal = Terminal()
    with stop_on_signals() as stop:
        taken_s = prepare_kernels(config, terminal, stop)
        if config.map.enabled:
            taken_s += run_warm_up(warm_up_reconstruction, terminal, stop)
            taken_s += prepare_loop_closure(terminal, stop)
        if config.recorder.enabled or config.map.enabled:
            taken_s += run_warm_up(_warm_up_depth_packing, terminal, stop)
        taken_s += run_warm_up(_warm_up_navigation, terminal, stop)
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


def _warm_up_navigation(on_progress: Callable[[str], None]) -> float:
    from vo_service.navigation.grid_mapper import GridMapper
    from vo_service.navigation.robot_scan import RobotScanner

    begin_s = time.monotonic()
    on_progress("scan and grid")
    RobotScanner.warm_up()
    GridMapper.warm_up()
    return time.monotonic() - begin_s


def _warm_up_renderer(on_progress: Callable[[str], None]) -> float:
    from drivers.synthetic.renderer import warm_up_renderer

    on_progress("virtual Kinect")
    return warm_up_renderer()
