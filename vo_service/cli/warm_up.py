"""``kinect-vo warm-up``: compile the kernels."""

import os
import platform
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from drivers.core import InputError
from drivers.core.folders import kernel_folder, prebuilt_kernels
from drivers.core.processor import add_carried_kernels, compile_for, is_known
from drivers.core.write_errors import creating
from vo_service.cli.kernels import compile_kernels, first_parts, run_warm_up
from vo_service.cli.options import ConfigFile, Method, Timing, load_config
from vo_service.cli.request import CommandRequest, flag, option
from vo_service.config import Config
from vo_service.kernels.loading import load_kernels
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal

EPILOG = """\
examples:
  kinect-vo warm-up                     as the user who will run kinect-vo
  kinect-vo warm-up --first             only what the first pose needs
  kinect-vo warm-up --for x86-64-v3     into an image, for computers with AVX2

The kernels are cached in $CACHE_DIRECTORY (systemd), else in $XDG_CACHE_HOME/kinect-vo, else in
~/.cache/kinect-vo. $NUMBA_CACHE_DIR names another folder. Kernels that set-up has compiled are
copied from there.

With --for they are compiled for a kind of processors instead of this one, into the environment
(share/kinect-vo/kernels), beside those of other kinds. There they are used by a computer of that
kind, and ignored by others, which compile their own. NAME is x86-64-v2, -v3 or -v4, or LLVM's name
of a processor of this architecture, as cortex-a72 (Raspberry Pi 4).
"""


@dataclass(frozen=True, kw_only=True)
class WarmUpRequest(CommandRequest):
    """The parts whose kernels are compiled."""

    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    first: bool = flag("only the kernels that the first pose needs; others are compiled when used")
    for_: str | None = option(
        "compile for this kind of processors, into the environment", None, "NAME"
    )


def run(request: WarmUpRequest) -> int:
    """Compile the kernels of the configured parts that are not in the cache."""
    config = load_config(request.config, request)
    if request.for_ is not None:
        _use_environment(request.for_)
    begin_s = time.monotonic()
    with stop_on_signals() as stop:
        parts = first_parts(config, config.camera.source) if request.first else _used_parts(config)
        terminal = Terminal()
        compile_kernels(parts, terminal, stop)
        if not request.first and request.for_ is None:
            run_warm_up(partial(_load_kernels, parts, stop.event), terminal, stop)
    if request.for_ is not None:
        add_carried_kernels(prebuilt_kernels(), request.for_)
    maps = " and of maps" if "loop closure" in parts else ""
    taken_s = time.monotonic() - begin_s
    print(f"the kernels of {config.odometry.method}{maps} are ready ({taken_s:.1f} s)")
    return 0


def _use_environment(processor: str) -> None:
    """Let kernels be compiled into the environment, for a kind of processors."""
    if not is_known(processor):
        raise InputError(
            f"--for {processor}: no processor of this architecture ({platform.machine()}) has that "
            "name; name x86-64-v2, x86-64-v3 or x86-64-v4, or LLVM's name, such as cortex-a72"
        )
    folder = prebuilt_kernels()
    with creating(folder):
        folder.mkdir(parents=True, exist_ok=True)
    compile_for(processor)
    os.environ["CACHE_DIRECTORY"] = str(folder.parent)
    os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())


def _load_kernels(
    parts: Sequence[str], stop: threading.Event, report: Callable[[str], None]
) -> None:
    """Load the kernels of parts, so that one with a damaged file is compiled anew."""
    for part in parts:
        report(part)
        load_kernels(part, stop)


def _used_parts(config: Config) -> list[str]:
    """List the parts whose kernels a configuration uses."""
    parts = [config.odometry.method, "scan", "grid", "Kinect"]
    if config.map.enabled:
        parts += ["reconstruction", "loop closure"]
    if config.has_recorder or config.map.enabled:
        parts += ["frame packing"]
    if config.camera.source == "synthetic":
        parts += ["virtual Kinect"]
    return parts
