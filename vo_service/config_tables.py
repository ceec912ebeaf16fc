"""Tables of the configuration file for the parts around the odometry; see `vo_service.config`."""

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from drivers.core.config import FILE_NAME_IN_WORDS, FILE_NAME_PATTERN, Field, FieldError

# Unit of the settings whose names end in _mb, bytes.
# A recording of the running service leaves this much of the disk free.
MIN_FREE_BYTES = 1_000_000_000
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7450"


@dataclass(frozen=True)
class RerunConfig:
    """`[rerun]`: targets and settings of the viewer."""

    targets: Annotated[
        tuple[str, ...],
        "serve (a page on this computer), connect or connect:HOST:PORT (an open viewer), or "
        "FILE.rrd (a recording)",
    ] = ()
    picture_hz: Annotated[
        float,
        Field("image rate of the viewer, Hz; all else is sent with every frame", minimum=0.1),
    ] = 10.0
    jpeg_quality: Annotated[int, Field("JPEG quality of color images", minimum=10, maximum=100)] = (
        80
    )
    memory_mb: Annotated[
        int, Field("memory limit of each viewer's process, libraries apart", minimum=250)
    ] = 300
    file_mb: Annotated[
        int, Field("size limit of an .rrd file; the next file follows", minimum=1)
    ] = 500
    files_kept: Annotated[int, Field("number of .rrd files to keep, newest first", minimum=1)] = 4


@dataclass(frozen=True)
class RecorderConfig:
    """`[recorder]`: the flight recorder, which keeps the last seconds of frames."""

    enabled: Annotated[
        bool | None,
        "false disables the flight recorder and recordings; unset = unless odometry.profile is "
        "small",
    ] = None
    seconds: Annotated[
        float, Field("length of an incident before its cause, s", minimum=0.5, maximum=600.0)
    ] = 3.0
    max_mb: Annotated[
        int, Field("memory limit of the ring of frames", minimum=10, maximum=1_000_000)
    ] = 200
    folder: Annotated[Path | None, "folder of the incidents; unset = below the state folder"] = None
    total_mb: Annotated[
        int,
        Field(
            "disk limit of all incidents; the oldest are deleted first",
            minimum=1,
            is_reloadable=True,
        ),
    ] = 2000
    save_on_loss: Annotated[
        bool, Field("write an incident whenever tracking is lost", is_reloadable=True)
    ] = True


@dataclass(frozen=True)
class MapConfig:
    """`[map]`: keyframes, loop closure, relocalization, saved maps and the occupancy grid."""

    enabled: Annotated[bool, "false disables the mapper: no keyframes, no saved maps"] = True
    loop_closure: Annotated[bool, "false disables loop closure and relocalization"] = True
    load: Annotated[
        str | None,
        Field(
            "name of the map to load at the start; unset = none",
            pattern=FILE_NAME_PATTERN,
            pattern_name=FILE_NAME_IN_WORDS,
        ),
    ] = None
    max_mb: Annotated[
        int,
        Field(
            "memory limit of the mesh keyframes; thinned out when full",
            minimum=10,
            is_reloadable=True,
        ),
    ] = 100
    keyframe_database_mb: Annotated[
        int, Field("memory limit of the keyframe database for loop closure", minimum=5)
    ] = 100
    resolution_m: Annotated[
        float, Field("side of a cell of the occupancy grid, m", minimum=0.01, maximum=0.5)
    ] = 0.05
    range_max_m: Annotated[
        float, Field("largest range of the occupancy grid's readings, m", minimum=0.5, maximum=10.0)
    ] = 4.0
    publish_hz: Annotated[
        float, Field("rate limit of the occupancy grid, Hz", minimum=0.01, maximum=10.0)
    ] = 1.0
    voxel_m: Annotated[
        float, Field("voxel size of the mesh, m", minimum=0.005, maximum=0.5, is_reloadable=True)
    ] = 0.02
    mesh_memory_mb: Annotated[
        int, Field("extra memory limit while meshing", minimum=50, is_reloadable=True)
    ] = 300
    total_mb: Annotated[
        int,
        Field(
            "disk limit of all maps; the oldest are deleted first", minimum=1, is_reloadable=True
        ),
    ] = 2000


@dataclass(frozen=True)
class ZenohConfig:
    """`[zenoh]`: publication of the poses.

    Raises:
        FieldError: If the prefix is not valid, an endpoint or a frame is named twice, or a frame
            has no name.
    """

    prefix: Annotated[
        str, "prefix of the Zenoh keys: PREFIX/odom, PREFIX/status, PREFIX/alive and others"
    ] = "kinect"
    listen: Annotated[
        tuple[str, ...], "endpoints to listen on; the default accepts this computer only"
    ] = (DEFAULT_ENDPOINT,)
    connect: Annotated[
        tuple[str, ...],
        'endpoints to connect to: a router or another peer, such as "tcp/192.168.1.2:7447"',
    ] = ()
    config_file: Annotated[
        Path | None,
        "a Zenoh configuration (JSON5), for TLS and access control. `listen`, `connect` and "
        "disabled scouting apply unless the file sets them",
    ] = None

    def __post_init__(self) -> None:
        check_prefix(self.prefix)
        if len(set(self.listen)) < len(self.listen):
            raise FieldError(("listen",), "has the same endpoint twice; remove one")


@dataclass(frozen=True)
class FrameIds:
    """`[ros2]`: names of the frames in all messages, as ROS has them."""

    odom_frame_id: Annotated[str, "parent frame of the poses"] = "odom"
    base_frame_id: Annotated[str, "child frame of the poses: the robot's base"] = "base_link"
    map_frame_id: Annotated[str, "fixed frame of the map, parent of `odom_frame_id`"] = "map"
    camera_frame_id: Annotated[str, "frame of images and points, optical axes"] = (
        "camera_rgb_optical_frame"
    )
    scan_frame_id: Annotated[str, "frame of the scan: level, below the camera"] = "camera_scan"

    def __post_init__(self) -> None:
        names: set[str] = {""}
        for key, name in vars(self).items():
            if name.startswith("/"):
                raise FieldError(
                    (key,), f"{name!r} begins with a slash, which tf2 refuses; give {name[1:]!r}"
                )
            if name in names:
                raise FieldError(
                    (key,), f"{name!r} is empty or the name of another frame; give another name"
                )
            names.add(name)


def check_prefix(prefix: str) -> str:
    """Check a key prefix and return it.

    Raises:
        FieldError: If it is not a list of plain names separated by ``/``.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise FieldError(
            ("prefix",),
            f"zenoh prefix {prefix!r}: use names of letters, digits, '_', '-', '.' separated by "
            "single slashes, without a slash at either end, such as robot1/kinect",
        )
    return prefix


@dataclass(frozen=True)
class FramesConfig:
    """`[frames]`: publication of images and points, each only while somebody subscribes."""

    enabled: Annotated[
        bool | None, "false = never; unset = unless anyone in the network could see them"
    ] = None
    max_hz: Annotated[
        float, Field("rate limit of each topic, Hz; a Kinect has 30", minimum=0.1, maximum=1000.0)
    ] = 60.0
    jpeg_quality: Annotated[int, Field("JPEG quality of color images", minimum=10, maximum=100)] = (
        90
    )
    point_stride: Annotated[
        int, Field("every n-th pixel of every n-th row is a point", minimum=1, maximum=32)
    ] = 2


@dataclass(frozen=True)
class ScanConfig:
    """`[scan]`: distances in a horizontal plane, from depth, only while somebody subscribes."""

    enabled: Annotated[bool | None, "false = never; unset = as frames.enabled"] = None
    min_height_m: Annotated[
        float, Field("least height of an obstacle above the floor, m", minimum=0.02, maximum=2.0)
    ] = 0.10
    max_height_m: Annotated[
        float | None,
        Field(
            "largest height of an obstacle, m, at least the robot's; unset = 0.15 m above the "
            "camera",
            minimum=0.05,
            maximum=5.0,
        ),
    ] = None
    range_min_m: Annotated[
        float, Field("least range, m; what is nearer is unknown", minimum=0.1, maximum=5.0)
    ] = 0.45
    range_max_m: Annotated[
        float, Field("largest range of the scan, m", minimum=0.5, maximum=20.0)
    ] = 4.5
    angle_increment_deg: Annotated[
        float, Field("angle between two ranges, degrees", minimum=0.1, maximum=5.0)
    ] = 0.5

    def __post_init__(self) -> None:
        if self.range_max_m <= self.range_min_m:
            raise FieldError(("range_max_m",), "must be larger than scan.range_min_m")
        if self.max_height_m is not None and self.max_height_m <= self.min_height_m:
            raise FieldError(("max_height_m",), "must be larger than scan.min_height_m")


@dataclass(frozen=True)
class WheelOdometryConfig:
    """`[wheel_odometry]`: the robot's wheels, a prior for views that show too little."""

    enabled: Annotated[bool, "true receives it, as nav_msgs/Odometry on PREFIX/wheel_odom"] = False
    topic: Annotated[
        str | None,
        "the topic of a recording that was not made by this program, such as odom",
    ] = None
    translation_sigma: Annotated[
        float,
        Field("standard deviation of the path, relative to it", minimum=0.001, maximum=1.0),
    ] = 0.05
    rotation_sigma: Annotated[
        float,
        Field("standard deviation of the angle turned, relative to it", minimum=0.001, maximum=1.0),
    ] = 0.05
    max_age_s: Annotated[float, Field("older poses are not used, s", minimum=0.02, maximum=2.0)] = (
        0.2
    )


@dataclass(frozen=True)
class CommandConfig:
    """`[commands]`: commands to the service over Zenoh."""

    enabled: Annotated[bool, "false disables all commands"] = True
    per_second: Annotated[
        float,
        Field(
            "rate limit of all clients together, commands per second",
            minimum=0.1,
            maximum=1000.0,
            is_reloadable=True,
        ),
    ] = 10.0


@dataclass(frozen=True)
class LoadConfig:
    """`[load]`: load shedding: the viewer is paused while the odometry is late."""

    adapt: Annotated[
        bool, Field("false disables load shedding; frames are dropped instead", is_reloadable=True)
    ] = True


class LogLevel(StrEnum):
    """Least level to log."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class LogConfig:
    """`[log]`: the log on stderr, and under systemd in the journal."""

    level: Annotated[
        LogLevel, Field("least level: debug, info, warning or error", is_reloadable=True)
    ] = LogLevel.WARNING
