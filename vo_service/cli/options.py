"""What several commands share: options, their effect on the configuration, and the kernels.

OpenCV is imported with the kernels, because most commands need neither.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from drivers.camera import PlaybackMode
from drivers.core import UserFacingError
from drivers.core.folders import cache_folder, kernel_folder
from drivers.core.jit import interruptible
from drivers.registry import CAMERA_USAGES, describe_cameras
from vo_service.config import Config, read_config
from vo_service.config_tables import DEFAULT_ENDPOINT, LogConfig, LogLevel
from vo_service.odometry.registry import METHODS, TIMING_MODES
from vo_service.odometry.warm_up import warm_up
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal

T = TypeVar("T")


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """Add --config, --method and --timing."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    parser.add_argument(
        "--method", metavar="METHOD", choices=METHODS,
        help=f"odometry method: {', '.join(METHODS.built_in)}, or a plug-in's (default: the "
        "config's)",
    )  # fmt: skip
    parser.add_argument(
        "--timing", choices=list(TIMING_MODES),
        help="readout and delay of the sensor: learned while the method direct runs, or fixed as "
        "the camera file tells (default: the config's)",
    )  # fmt: skip


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """Add --camera, --camera-file and --topics."""
    parser.add_argument(
        "--camera", metavar="SOURCE", type=_parse_source,
        help=f"the camera (default: the config's): {', '.join(CAMERA_USAGES.values())}, "
        "or NAME[:ARGUMENT] of a plug-in",
    )  # fmt: skip
    add_camera_file_option(parser)
    add_topics_option(parser)


def add_camera_file_option(parser: argparse.ArgumentParser) -> None:
    """Add --camera-file."""
    parser.add_argument(
        "--camera-file", metavar="FILE", type=Path,
        help="camera file (TOML, or YAML of OpenCV, ROS or ORB-SLAM) of the sensor or recording "
        "(default: the config's, or the recording's own)",
    )  # fmt: skip


def add_topics_option(parser: argparse.ArgumentParser) -> None:
    """Add --topics."""
    parser.add_argument(
        "--topics", metavar=("COLOR", "DEPTH"), nargs=2,
        help="topics of the color and depth images in a bag (default: they are found)",
    )  # fmt: skip


def requested_topics(args: argparse.Namespace) -> tuple[str, str] | None:
    """Return the topics of --topics."""
    return None if args.topics is None else (args.topics[0], args.topics[1])


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add --trajectory, --mcap, --rerun and --no-publish."""
    parser.add_argument(
        "--trajectory", metavar="FILE", type=Path,
        help="write the poses of the optical camera: stamp tx ty tz qx qy qz qw (an existing file: "
        "replay replaces it, run renames it)",
    )  # fmt: skip
    parser.add_argument(
        "--mcap", metavar="FILE", type=Path,
        help="record frames, poses, transforms, timing and status into FILE.mcap; color is JPEG",
    )  # fmt: skip
    parser.add_argument(
        "--rerun", metavar="TARGET", action="append",
        help="show the results in Rerun: serve (a page on this computer), connect or "
        "connect:HOST:PORT (an open viewer), or FILE.rrd (a recording); may be given several times",
    )  # fmt: skip
    add_publish_option(parser)


def add_publish_option(parser: argparse.ArgumentParser) -> None:
    """Add --no-publish."""
    parser.add_argument(
        "--no-publish", action="store_true", help="do not publish over Zenoh, and open no port"
    )


def add_prefix_option(parser: argparse.ArgumentParser) -> None:
    """Add --prefix."""
    parser.add_argument(
        "--prefix", metavar="PREFIX", help="prefix of the Zenoh keys (default: the config's)"
    )


def load_config(args: argparse.Namespace) -> Config:
    """Read the configuration file and apply the options of the command line.

    Raises:
        InputError: If the file or an option is not valid.
    """
    config = read_config(args.config)
    if getattr(args, "method", None):
        config = replace(config, odometry=replace(config.odometry, method=args.method))
    if getattr(args, "timing", None):
        config = replace(config, odometry=replace(config.odometry, timing=args.timing))
    if getattr(args, "rerun", None):
        config = replace(config, rerun=replace(config.rerun, targets=tuple(args.rerun)))
    if config.rerun.targets:
        _check_rerun_targets(config.rerun.targets)
    if getattr(args, "pace", None) is PlaybackMode.LOCKSTEP:  # results must be repeatable
        config = replace(
            config,
            load=replace(config.load, adapt=False),
            # A loop closure process replies at any time; --loop-closure of a replay is synchronous.
            map=replace(config.map, loop_closure=False),
        )
    if args.verbose:
        config = replace(config, log=LogConfig(LogLevel.INFO))
    if getattr(args, "prefix", None):
        config = replace(config, zenoh=replace(config.zenoh, prefix=args.prefix))
    return config


def _check_rerun_targets(targets: Sequence[str]) -> None:
    """Check targets before anything is opened; raise InputError if one is not valid."""
    from vo_service.outputs.rerun.targets import check_targets, prepare_rerun

    check_targets(targets)
    prepare_rerun()


def _parse_source(text: str) -> str:
    """Parse a camera. Refuse "", such as from an unset variable: it would mean the config's."""
    if not text:
        raise argparse.ArgumentTypeError(f"is empty: give one of {describe_cameras()}")
    return text


def parse_playback_mode(text: str) -> PlaybackMode:
    """Parse a playback mode.

    Raises:
        ArgumentTypeError: If there is no such mode.
    """
    try:
        return PlaybackMode(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text} is not a pace: give {' or '.join(PlaybackMode)}"
        ) from error


def print_message(text: str) -> None:
    """Print a message for the user to stderr; results go to stdout."""
    print(text, file=sys.stderr, flush=True)


def parse_seconds(text: str) -> float:
    """Parse a positive number of seconds.

    Raises:
        ArgumentTypeError: If it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is not a duration: give seconds, more than 0")
    return value


def parse_finite(text: str) -> float:
    """Parse a number of seconds, which may be negative.

    Raises:
        ArgumentTypeError: If it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e11:
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds")
    return value


def parse_count(text: str) -> int:
    """Parse a whole number, 1 or more.

    Raises:
        ArgumentTypeError: If it is none.
    """
    if not (text.isascii() and text.isdigit() and int(text[:9]) > 0):
        raise argparse.ArgumentTypeError(f"{text} is not a count: give a whole number, 1 or more")
    return int(text)


def add_connection_options(parser: argparse.ArgumentParser) -> None:
    """--connect, --prefix and --config-file."""
    parser.add_argument(
        "--connect", metavar="ENDPOINT", default=DEFAULT_ENDPOINT,
        help="where it publishes (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--prefix", default="kinect", help="prefix of its Zenoh keys (default: %(default)s)"
    )
    parser.add_argument(
        "--config-file", metavar="ZENOH.json5", type=Path,
        help="a Zenoh configuration, for TLS; its endpoints, if any, replace --connect",
    )  # fmt: skip


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
