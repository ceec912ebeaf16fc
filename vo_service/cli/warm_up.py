"""``kinect-vo warm-up``: compile the kernels."""

import time
from dataclasses import dataclass

from vo_service.cli.kernels import compile_kernels
from vo_service.cli.options import ConfigFile, Method, Timing, load_config
from vo_service.cli.request import CommandRequest
from vo_service.config import Config
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
    """Compile the kernels of the configured parts that are not in the cache.

    Raises:
        UserFacingError: If the configuration is not valid, or if the kernels cannot be written.
    """
    config = load_config(request.config, request)
    begin_s = time.monotonic()
    with stop_on_signals() as stop:
        compile_kernels(_used_parts(config), Terminal(), stop)
    maps = " and of maps" if config.map.enabled else ""
    taken_s = time.monotonic() - begin_s
    print(f"the kernels of {config.odometry.method}{maps} are ready ({taken_s:.1f} s)")
    return 0


def _used_parts(config: Config) -> list[str]:
    """List the parts whose kernels a configuration uses."""
    parts = [config.odometry.method, "scan", "grid"]
    if config.map.enabled:
        parts += ["reconstruction", "loop closure"]
    if config.recorder.enabled or config.map.enabled:
        parts += ["depth packing"]
    if config.camera.source == "synthetic":
        parts += ["virtual Kinect"]
    return parts
