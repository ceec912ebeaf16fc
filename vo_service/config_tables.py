"""Tables of the configuration file for what stands around the odometry; see `vo_service.config`."""

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from drivers.core.config import config_field
from drivers.core.errors import InputError

# Bytes: what settings whose names end in _mb count in.
MEGABYTE = 1_000_000
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7450"


@dataclass(frozen=True)
class RerunConfig:
    """`[rerun]`: what to show, and where."""

    targets: tuple[str, ...] = config_field(
        (), "any of: serve, connect, connect:HOST:PORT, or a file that ends in .rrd"
    )
    picture_hz: float = config_field(
        10.0, "pictures a second; numbers go with every frame", minimum=0.1
    )
    jpeg_quality: int = config_field(80, "of color images, percent", minimum=10, maximum=100)
    memory_mb: int = config_field(300, "most memory of each viewer's process", minimum=250)
    file_mb: int = config_field(
        500, "an .rrd file of this size is closed and the next begun", minimum=1
    )
    files_kept: int = config_field(4, "newest .rrd files that are kept", minimum=1)


@dataclass(frozen=True)
class RecorderConfig:
    """`[recorder]`: the flight recorder, which keeps the last seconds of frames."""

    enabled: bool = config_field(True, "false keeps no frames, and cannot record on command")
    seconds: float = config_field(
        3.0, "how much of the past an incident holds", minimum=0.5, maximum=600.0
    )
    max_mb: int = config_field(200, "most memory of the ring of frames", minimum=10)
    folder: Path | None = config_field(None, "where incidents go; unset = below the state folder")
    total_mb: int = config_field(2000, "of all incidents; the oldest are deleted first", minimum=1)
    save_on_loss: bool = config_field(True, "write an incident whenever tracking is lost")


@dataclass(frozen=True)
class MapConfig:
    """`[map]`: keyframes of where the camera has been, loop closure and relocalization."""

    enabled: bool = config_field(True, "false keeps no keyframes, and cannot save a map")
    loop_closure: bool = config_field(True, "false disables loop closure and relocalization")
    load: str | None = config_field(None, "name of a saved map to begin in; unset = a new one")
    max_mb: int = config_field(
        100, "most memory of the keyframes, thinned out when it is full", minimum=10
    )
    keyframe_database_mb: int = config_field(
        100, "memory limit of the keyframe database for loop closure", minimum=5
    )
    voxel_m: float = config_field(
        0.02, "finest detail of a map, metres", minimum=0.005, maximum=0.5
    )
    mesh_memory_mb: int = config_field(300, "extra memory limit while meshing", minimum=50)
    total_mb: int = config_field(2000, "of all maps; the oldest are deleted first", minimum=1)


@dataclass(frozen=True)
class ZenohConfig:
    """How poses go out. Raises InputError for a prefix that is none."""

    prefix: str = config_field(
        "kinect", "first part of every key: PREFIX/odom, PREFIX/status, PREFIX/alive and others"
    )
    listen: tuple[str, ...] = config_field(
        (DEFAULT_ENDPOINT,), "endpoints that others connect to; the default is this computer alone"
    )
    connect: tuple[str, ...] = config_field(
        (), 'endpoints to connect to: a router or another peer, such as "tcp/192.168.1.2:7447"'
    )
    config_file: Path | None = config_field(
        None,
        "a Zenoh configuration (JSON5), for TLS and access control. What it leaves at Zenoh's own "
        "default is set as without it: listen, connect, no scouting",
    )
    odom_frame_id: str = config_field("odom", "frame of the poses")
    child_frame_id: str = config_field("base_link", "frame that moves")
    map_frame_id: str = config_field("map", "fixed frame of the map, parent of `odom`")

    def __post_init__(self) -> None:
        check_prefix(self.prefix)


def check_prefix(prefix: str) -> str:
    """The prefix itself. Raises InputError unless plain names separated by ``/``."""
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise InputError(
            f"zenoh prefix {prefix!r}: use names of letters, digits, '_', '-', '.' separated by "
            "single slashes, without a slash at either end, such as robot1/kinect"
        )
    return prefix


@dataclass(frozen=True)
class Ros2Config:
    """`[ros2]`: the poses as a ROS 2 node would publish them. Experimental."""

    enabled: bool = config_field(False, "true also publishes under ROS 2's own keys")
    domain_id: int = config_field(0, "ROS_DOMAIN_ID of the readers", minimum=0, maximum=232)
    topic: str = config_field("vo/odom", "topic of the odometry, without the first slash")
    tf: bool = config_field(True, "also publish the transform on /tf")

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", self.topic, re.ASCII):
            raise ValueError(
                f"topic {self.topic!r} is none of ROS 2; use names separated by single slashes, "
                "such as vo/odom"
            )


@dataclass(frozen=True)
class CommandConfig:
    """`[commands]`: what others may ask of the service over Zenoh."""

    enabled: bool = config_field(True, "false answers no command")
    per_second: float = config_field(
        10.0, "commands a second, from all together", minimum=0.1, maximum=1000.0
    )


@dataclass(frozen=True)
class LoadConfig:
    """`[load]`: what to give up when the machine is too slow: pictures first, then features."""

    adapt: bool = config_field(True, "false never gives anything up; frames are dropped instead")
    min_features: int = config_field(
        300, "never look for fewer features in a frame", minimum=50, maximum=5000
    )


class LogLevel(StrEnum):
    """How much to log."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class LogConfig:
    """`[log]`: what goes to stderr, and under systemd to the journal."""

    level: LogLevel = config_field(LogLevel.WARNING, "debug, info, warning or error")
