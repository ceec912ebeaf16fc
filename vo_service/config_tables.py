"""Tables of the configuration file for the parts around the odometry; see `vo_service.config`."""

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from drivers.core.config import config_field
from drivers.core.errors import InputError

# Unit of the settings whose names end in _mb, bytes.
MEGABYTE = 1_000_000
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7450"


@dataclass(frozen=True)
class RerunConfig:
    """`[rerun]`: targets and settings of the viewer."""

    targets: tuple[str, ...] = config_field(
        (), "any of: serve, connect, connect:HOST:PORT, or a file that ends in .rrd"
    )
    picture_hz: float = config_field(
        10.0, "image rate of the viewer, Hz; all else is sent with every frame", minimum=0.1
    )
    jpeg_quality: int = config_field(80, "JPEG quality of color images", minimum=10, maximum=100)
    memory_mb: int = config_field(300, "memory limit of each viewer's process", minimum=250)
    file_mb: int = config_field(500, "size limit of an .rrd file; the next file follows", minimum=1)
    files_kept: int = config_field(4, "number of .rrd files to keep, newest first", minimum=1)


@dataclass(frozen=True)
class RecorderConfig:
    """`[recorder]`: the flight recorder, which keeps the last seconds of frames."""

    enabled: bool = config_field(True, "false disables the flight recorder and recordings")
    seconds: float = config_field(
        3.0, "length of an incident before its cause, s", minimum=0.5, maximum=600.0
    )
    max_mb: int = config_field(200, "memory limit of the ring of frames", minimum=10)
    folder: Path | None = config_field(
        None, "folder of the incidents; unset = below the state folder"
    )
    total_mb: int = config_field(
        2000, "disk limit of all incidents; the oldest are deleted first", minimum=1
    )
    save_on_loss: bool = config_field(True, "write an incident whenever tracking is lost")


@dataclass(frozen=True)
class MapConfig:
    """`[map]`: keyframes, loop closure, relocalization and saved maps."""

    enabled: bool = config_field(True, "false disables the mapper: no keyframes, no saved maps")
    loop_closure: bool = config_field(True, "false disables loop closure and relocalization")
    load: str | None = config_field(None, "name of the map to load at the start; unset = none")
    max_mb: int = config_field(
        100, "memory limit of the mesh keyframes; thinned out when full", minimum=10
    )
    keyframe_database_mb: int = config_field(
        100, "memory limit of the keyframe database for loop closure", minimum=5
    )
    voxel_m: float = config_field(0.02, "voxel size of the mesh, m", minimum=0.005, maximum=0.5)
    mesh_memory_mb: int = config_field(300, "extra memory limit while meshing", minimum=50)
    total_mb: int = config_field(
        2000, "disk limit of all maps; the oldest are deleted first", minimum=1
    )


@dataclass(frozen=True)
class ZenohConfig:
    """`[zenoh]`: publication of the poses.

    Raises:
        InputError: If the prefix is not valid.
    """

    prefix: str = config_field(
        "kinect", "first part of every key: PREFIX/odom, PREFIX/status, PREFIX/alive and others"
    )
    listen: tuple[str, ...] = config_field(
        (DEFAULT_ENDPOINT,), "endpoints to listen on; the default accepts this computer only"
    )
    connect: tuple[str, ...] = config_field(
        (), 'endpoints to connect to: a router or another peer, such as "tcp/192.168.1.2:7447"'
    )
    config_file: Path | None = config_field(
        None,
        "a Zenoh configuration (JSON5), for TLS and access control. `listen`, `connect` and "
        "disabled scouting apply unless the file sets them",
    )
    odom_frame_id: str = config_field("odom", "parent frame of the poses")
    child_frame_id: str = config_field("base_link", "child frame of the poses: the robot's base")
    map_frame_id: str = config_field("map", "fixed frame of the map, parent of `odom`")

    def __post_init__(self) -> None:
        check_prefix(self.prefix)


def check_prefix(prefix: str) -> str:
    """Check a key prefix and return it.

    Raises:
        InputError: If it is not a list of plain names separated by ``/``.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise InputError(
            f"zenoh prefix {prefix!r}: use names of letters, digits, '_', '-', '.' separated by "
            "single slashes, without a slash at either end, such as robot1/kinect"
        )
    return prefix


@dataclass(frozen=True)
class Ros2Config:
    """`[ros2]`: publication of the poses for ROS 2. Experimental."""

    enabled: bool = config_field(False, "true also publishes under ROS 2's own keys")
    domain_id: int = config_field(0, "ROS_DOMAIN_ID of the readers", minimum=0, maximum=232)
    topic: str = config_field("vo/odom", "topic of the odometry, without the first slash")
    tf: bool = config_field(True, "also publish the transform on /tf")

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", self.topic, re.ASCII):
            raise ValueError(
                f"topic {self.topic!r} is not a valid ROS 2 topic; use names separated by single "
                "slashes, such as vo/odom"
            )


@dataclass(frozen=True)
class CommandConfig:
    """`[commands]`: commands to the service over Zenoh."""

    enabled: bool = config_field(True, "false disables all commands")
    per_second: float = config_field(
        10.0, "rate limit of all clients together, commands per second", minimum=0.1, maximum=1000.0
    )


@dataclass(frozen=True)
class LoadConfig:
    """`[load]`: load shedding when the machine is too slow: first the viewer, then features."""

    adapt: bool = config_field(True, "false disables load shedding; frames are dropped instead")
    min_features: int = config_field(
        300, "least number of features per frame", minimum=50, maximum=5000
    )


class LogLevel(StrEnum):
    """Least level to log."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class LogConfig:
    """`[log]`: the log on stderr, and under systemd in the journal."""

    level: LogLevel = config_field(LogLevel.WARNING, "least level: debug, info, warning or error")
