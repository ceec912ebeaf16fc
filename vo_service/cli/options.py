"""Options that several commands share, and what they change in the configuration."""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.registry import CAMERA_USAGES
from vo_service.config import Config, read_config
from vo_service.config_tables import DEFAULT_ENDPOINT, LogConfig, LogLevel
from vo_service.odometry.registry import METHODS


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """--config and --method."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    parser.add_argument(
        "--method", choices=list(METHODS), help="how motion is estimated (default: the config's)"
    )


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--camera and --camera-file."""
    parser.add_argument(
        "--camera", metavar="SOURCE", type=_parse_source,
        help=f"the camera (default: the config's): {', '.join(CAMERA_USAGES.values())}",
    )  # fmt: skip
    parser.add_argument(
        "--camera-file", metavar="FILE", type=Path,
        help="camera file (TOML) of this sensor or recording (default: the config's)",
    )  # fmt: skip


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """--trajectory, --rerun, --no-publish."""
    parser.add_argument(
        "--trajectory", metavar="FILE", type=Path,
        help="write the poses of the optical camera: stamp tx ty tz qx qy qz qw",
    )  # fmt: skip
    parser.add_argument(
        "--rerun", metavar="TARGET", action="append",
        help="show it in Rerun: serve (a page on this computer), connect or connect:HOST:PORT "
        "(a viewer that is open), or FILE.rrd (a recording); may be given several times",
    )  # fmt: skip
    add_publish_option(parser)


def add_publish_option(parser: argparse.ArgumentParser) -> None:
    """--no-publish."""
    parser.add_argument(
        "--no-publish", action="store_true", help="do not publish over Zenoh, listen nowhere"
    )


def add_prefix_option(parser: argparse.ArgumentParser) -> None:
    """--prefix."""
    parser.add_argument(
        "--prefix", metavar="PREFIX", help="of the Zenoh keys (default: the config's)"
    )


def add_benchmark_options(parser: argparse.ArgumentParser) -> None:
    """FOLDER..., --config, --camera, --time-limit, --force, --json: of methods that are tried."""
    parser.add_argument(
        "folders", metavar="FOLDER", nargs="+", type=Path, help="recordings in TUM format"
    )
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    parser.add_argument(
        "--camera", metavar="FILE", type=Path, help="camera file (TOML) for all folders"
    )
    parser.add_argument(
        "--time-limit", metavar="SECONDS", type=parse_seconds, default=3600.0,
        help="a run that takes longer is ended, and a row says so (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument(
        "--loop-closure", action="store_true",
        help="also optimize each trajectory by loop closure; the methods' own figures stay",
    )  # fmt: skip
    parser.add_argument("--force", action="store_true", help="re-run cached results")
    parser.add_argument("--json", action="store_true", help="print report.json, nothing else")


def load_config(args: argparse.Namespace) -> Config:
    """The configuration file with the command line's changes. Raises InputError."""
    config = read_config(args.config)
    if getattr(args, "method", None):
        config = replace(config, odometry=replace(config.odometry, method=args.method))
    if getattr(args, "rerun", None):
        config = replace(config, rerun=replace(config.rerun, targets=tuple(args.rerun)))
    if config.rerun.targets:
        _check_rerun_targets(config.rerun.targets)
    if getattr(args, "pace", None) is PlaybackMode.LOCKSTEP:  # the same results on a slow machine
        config = replace(
            config,
            load=replace(config.load, adapt=False),
            # Another process answers when it can; a replay asks on its own thread (--loop-closure).
            map=replace(config.map, loop_closure=False),
        )
    if args.verbose:
        config = replace(config, log=LogConfig(LogLevel.INFO))
    if getattr(args, "prefix", None):
        config = replace(config, zenoh=replace(config.zenoh, prefix=args.prefix))
    return config


def _check_rerun_targets(targets: Sequence[str]) -> None:
    """Check targets before anything is opened. Raises InputError."""
    from vo_service.outputs.rerun.targets import check_targets, prepare_rerun

    check_targets(targets)
    prepare_rerun()


def _parse_source(text: str) -> str:
    """Parse a camera; "", of a variable that is not set, would otherwise mean the config's."""
    if not text:
        raise argparse.ArgumentTypeError(
            f"is empty: give one of {', '.join(CAMERA_USAGES.values())}"
        )
    return text


def parse_playback_mode(text: str) -> PlaybackMode:
    """Parse a pace."""
    try:
        return PlaybackMode(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text} is not a pace: give {' or '.join(PlaybackMode)}"
        ) from error


def print_message(text: str) -> None:
    """Tell the person at the terminal something that is no result."""
    print(text, file=sys.stderr, flush=True)


def parse_seconds(text: str) -> float:
    """Parse a positive number of seconds."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is not a time: give seconds, more than 0")
    return value


def parse_count(text: str) -> int:
    """Parse a whole number, 1 or more."""
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
        "--prefix", default="kinect", help="its zenoh prefix (default: %(default)s)"
    )
    parser.add_argument(
        "--config-file", metavar="ZENOH.json5", type=Path,
        help="a Zenoh configuration: for TLS, and instead of --connect where it says where",
    )  # fmt: skip
