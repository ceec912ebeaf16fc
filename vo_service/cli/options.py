"""Options that several commands have, and their effect on the configuration."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from drivers.camera import PlaybackMode
from drivers.registry import describe_cameras
from vo_service.cli.request import (
    Argument,
    CommandRequest,
    Option,
    config_option,
    number_parser,
    with_options,
)
from vo_service.config import Config, read_config
from vo_service.config_tables import LogConfig, LogLevel, ZenohConfig
from vo_service.odometry.registry import METHODS, PROFILES, TIMING_MODES


def print_message(text: str) -> None:
    """Print a message for the user to stderr; results go to stdout."""
    print(text, file=sys.stderr, flush=True)


def parse_playback_mode(text: str) -> PlaybackMode:
    """Parse a playback mode; raise ArgumentTypeError if there is no such mode."""
    try:
        return PlaybackMode(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text} is not a pace: give {' or '.join(PlaybackMode)}"
        ) from error


parse_seconds = number_parser(
    float, lambda value: 0 < value < 1e9, "is not a duration: give seconds, more than 0"
)
parse_finite = number_parser(float, lambda value: abs(value) < 1e11, "is not a number of seconds")
parse_length_m = number_parser(
    float,
    lambda value: 0.001 <= value <= 1.0,
    "is out of range: give meters, such as 0.025 for 25 mm",
)
parse_height_m = number_parser(
    float, lambda value: 0.0 < value <= 100.0, "is not a height: give meters, more than 0"
)
parse_tilt_deg = number_parser(
    float, lambda value: abs(value) <= 90.0, "is not a tilt: give degrees from -90 to 90"
)
parse_count = number_parser(
    int, lambda value: value >= 1, "is not a count: give a whole number, 1 or more"
)


def _parse_source(text: str) -> str:
    """Parse a camera. Refuse "", such as from an unset variable: it would mean the config's."""
    if not text:
        raise argparse.ArgumentTypeError(f"is empty: give one of {describe_cameras()}")
    return text


RERUN_TARGETS = config_option("rerun.targets", "").description

RECORDING_HELP = (
    "the recording: a folder in TUM format or another benchmark's layout, an MCAP file or a ROS "
    "bag; of a split bag its folder, or its files joined by commas"
)

# Types of the fields that requests of several commands have.
Recording = Annotated[Path, Argument(RECORDING_HELP, metavar="RECORDING")]
ConfigFile = Annotated[Path | None, Option("configuration file (TOML)", metavar="FILE")]
Method = Annotated[str | None, config_option("odometry.method", metavar="METHOD", allowed=METHODS)]
Timing = Annotated[str | None, config_option("odometry.timing", allowed=TIMING_MODES)]
Profile = Annotated[str | None, config_option("odometry.profile", allowed=PROFILES)]
# The source is no key of the configuration here: the path of a recording alone is enough.
CameraSource = Annotated[
    str | None,
    replace(config_option("camera.source", metavar="SOURCE", parse=_parse_source), key=""),
]
CameraFile = Annotated[
    Path | None,
    config_option(
        "camera.file", " (default: the config's, or the recording's own)", metavar="FILE"
    ),
]
Topics = Annotated[
    tuple[str, str] | None,
    Option(
        "topics of the color and depth images in a bag (default: they are found)",
        metavar=("COLOR", "DEPTH"),
    ),
]
Json = Annotated[bool, Option("print one JSON object, nothing else")]
TrajectoryFile = Annotated[
    Path | None,
    Option(
        "write the poses of the optical camera: stamp tx ty tz qx qy qz qw (an existing file: "
        "replay replaces it, run renames it)",
        metavar="FILE",
    ),
]
McapFile = Annotated[
    Path | None,
    Option(
        "record frames, poses, transforms, timing and status into FILE.mcap; color is JPEG",
        metavar="FILE",
    ),
]
RerunTargets = Annotated[
    tuple[str, ...],
    config_option(
        "rerun.targets",
        description=f"show the results in Rerun: {RERUN_TARGETS}; may be given several times",
        metavar="TARGET",
        is_repeated=True,
    ),
]
NoPublish = Annotated[bool, Option("do not publish over Zenoh, and open no port")]
# Of a program that connects to a service.
Connect = Annotated[str, Option("where it publishes (default: %(default)s)", metavar="ENDPOINT")]
ClientPrefix = Annotated[str, Option("prefix of its Zenoh keys (default: %(default)s)")]
ClientConfigFile = Annotated[
    Path | None,
    Option(
        "a Zenoh configuration, for TLS; its endpoints, if any, replace --connect",
        metavar="ZENOH.json5",
    ),
]
DEFAULT_PREFIX = ZenohConfig().prefix


def load_config(path: Path | None, request: CommandRequest) -> Config:
    """Read the configuration file and apply the options of a request.

    Raises:
        InputError: If the file or an option is not valid.
    """
    config = with_options(request, read_config(path))
    if config.rerun.targets:
        _check_rerun_targets(config.rerun.targets)
    return replace(config, log=LogConfig(LogLevel.INFO)) if request.verbose else config


def at_pace(config: Config, pace: PlaybackMode) -> Config:
    """Return the configuration for a pace: the results of lockstep must be repeatable."""
    if pace is PlaybackMode.REALTIME:
        return config
    return replace(
        config,
        load=replace(config.load, adapt=False),
        # A loop closure process replies at any time; --loop-closure of a replay is synchronous.
        map=replace(config.map, loop_closure=False),
    )


def _check_rerun_targets(targets: Sequence[str]) -> None:
    """Check targets before anything is opened; raise InputError if one is not valid."""
    from vo_service.outputs.rerun.targets import check_targets, prepare_rerun

    check_targets(targets)
    prepare_rerun()
