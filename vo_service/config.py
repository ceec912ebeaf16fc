"""The configuration: read the file, compare two configurations, and reload."""

import dataclasses
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from drivers.camera import PlaybackMode, SensorConfig
from drivers.core import PluginGroup, UserFacingError
from drivers.core.config import Field, FieldError, read_toml, suggest_choice, typed_fields
from drivers.core.geometry import T_BODY_CAMERA, Array, transform_from_pose
from drivers.registry import CAMERA_USAGES, CAMERAS
from drivers.synthetic.config import SyntheticConfig
from vo_service.config_tables import (
    CommandConfig,
    FrameIds,
    FramesConfig,
    LoadConfig,
    LogConfig,
    MapConfig,
    RecorderConfig,
    RerunConfig,
    ScanConfig,
    WheelOdometryConfig,
    ZenohConfig,
)
from vo_service.leveling.leveling import MIN_MOUNT_HEIGHT_M
from vo_service.odometry.registry import (
    DEFAULT_METHOD,
    DEFAULT_PROFILE,
    DEFAULT_TIMING_MODE,
    MAX_FEATURES,
    METHODS,
    MIN_FEATURES,
    PROFILES,
    SMALL_PROFILE,
    TIMING_MODES,
    make_odometry,
)
from vo_service.types.odometry import Odometry, StageTimer, WorkQueue
from vo_service.types.outputs import Output

logger = logging.getLogger(__name__)

OUTPUTS: PluginGroup[Callable[[str, PlaybackMode], Output]] = PluginGroup(
    "kinect_vo.outputs", "output", ("trajectory",)
)


@dataclass(frozen=True)
class ExtraOutputsConfig:
    """`[outputs]`: further outputs."""

    extra: Annotated[
        tuple[str, ...], "any of: trajectory:FILE, or NAME[:ARGUMENT] of a plug-in"
    ] = ()
    mcap: Annotated[
        Path | None, "MCAP file that `run` records: frames, poses, transforms, timing and status"
    ] = None

    def __post_init__(self) -> None:
        for output in self.extra:
            kind, _, argument = output.partition(":")
            if kind not in OUTPUTS:
                hint = suggest_choice(kind, OUTPUTS)
                raise FieldError(("extra",), f"output {output!r} is unknown; {hint}")
            if kind == "trajectory" and not argument:
                raise FieldError(
                    ("extra",), f"output {output!r} names no file; use trajectory:FILE"
                )


@dataclass(frozen=True)
class CameraConfig:
    """`[camera]`: source of the frames."""

    source: Annotated[
        str,
        Field(f"the camera: {', '.join(CAMERA_USAGES.values())}, or NAME[:ARGUMENT] of a plug-in"),
    ] = "synthetic"
    file: Annotated[
        Path | None,
        "camera file (TOML, or YAML of OpenCV, ROS or ORB-SLAM) of the sensor or recording",
    ] = None
    stamp_offset_s: Annotated[
        float, Field("added to every published stamp, seconds", minimum=-1.0, maximum=1.0)
    ] = 0.0

    def __post_init__(self) -> None:
        kind = self.source.partition(":")[0]
        if kind not in CAMERAS:
            hint = suggest_choice(kind, CAMERAS)
            raise FieldError(("source",), f"camera {self.source!r} is unknown; {hint}")


@dataclass(frozen=True)
class OdometryConfig:
    """`[odometry]`: estimation of the motion."""

    method: Annotated[
        str, Field(f"odometry method: {', '.join(METHODS.built_in)}, or a plug-in's")
    ] = DEFAULT_METHOD
    feature_count: Annotated[
        int,
        Field(
            "features to find in a frame",
            minimum=MIN_FEATURES,
            maximum=MAX_FEATURES,
            is_reloadable=True,
        ),
    ] = 1000
    upright: Annotated[bool, "true for a camera that never rolls: faster, more matches"] = False
    timing: Annotated[
        str,
        "readout, delay and focal length of the sensor: learned while the method direct runs, or "
        "fixed as the camera file tells",
    ] = DEFAULT_TIMING_MODE
    profile: Annotated[
        str,
        "default, or small for a small board: direct uses half the points, and the flight recorder "
        "is off unless recorder.enabled is true",
    ] = DEFAULT_PROFILE

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            hint = suggest_choice(self.method, METHODS)
            raise FieldError(("method",), f"{self.method!r} is unknown; {hint}")
        if self.timing not in TIMING_MODES:
            hint = suggest_choice(self.timing, TIMING_MODES)
            raise FieldError(("timing",), f"{self.timing!r} is unknown; {hint}")
        if self.profile not in PROFILES:
            hint = suggest_choice(self.profile, PROFILES)
            raise FieldError(("profile",), f"{self.profile!r} is unknown; {hint}")

    def make_odometry(self, timer: StageTimer, deferred: WorkQueue) -> Odometry:
        """Make the odometry that the table describes."""
        return make_odometry(
            self.method,
            feature_count=self.feature_count,
            upright=self.upright,
            timing=self.timing,
            profile=self.profile,
            timer=timer,
            deferred=deferred,
        )


# Meters; millimeters by mistake are beyond it.
MAX_MOUNTING_M = 100.0


@dataclass(frozen=True)
class MountingConfig:
    """`[T_base_camera]`: pose of the camera's optical frame in the robot's base_link."""

    translation_m: Annotated[
        tuple[float, float, float],
        Field("x y z in base_link, m", minimum=-MAX_MOUNTING_M, maximum=MAX_MOUNTING_M),
    ] = (0.0, 0.0, 0.0)
    quaternion_xyzw: Annotated[
        tuple[float, float, float, float],
        "optical axes in base_link; the default looks straight ahead",
    ] = (-0.5, 0.5, -0.5, 0.5)

    def __post_init__(self) -> None:
        if abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 1e-2:
            raise FieldError(("quaternion_xyzw",), "must have length 1, as x y z w")

    @property
    def T_base_camera(self) -> Array:
        """4x4 transform from optical camera coordinates to base_link."""
        if self == MountingConfig():
            return T_BODY_CAMERA
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class BaseConfig:
    """`[base]`: the robot's base."""

    planar: Annotated[
        bool,
        "true for a base on wheels, on one level floor: z, roll and pitch of its pose are 0",
    ] = False


@dataclass(frozen=True)
class Config:
    """A configuration file: one field per table. Every table and key is optional."""

    camera: CameraConfig = CameraConfig()
    sensor: SensorConfig = SensorConfig()  # noqa: RUF009 (frozen)
    odometry: OdometryConfig = OdometryConfig()
    base: BaseConfig = BaseConfig()
    T_base_camera: MountingConfig = MountingConfig()
    zenoh: ZenohConfig = ZenohConfig()  # noqa: RUF009 (frozen)
    frames: FramesConfig = FramesConfig()  # noqa: RUF009 (frozen)
    scan: ScanConfig = ScanConfig()  # noqa: RUF009 (frozen)
    ros2: FrameIds = FrameIds()  # noqa: RUF009 (frozen)
    commands: CommandConfig = CommandConfig()  # noqa: RUF009 (frozen)
    wheel_odometry: WheelOdometryConfig = WheelOdometryConfig()  # noqa: RUF009 (frozen)
    rerun: RerunConfig = RerunConfig()  # noqa: RUF009 (frozen)
    recorder: RecorderConfig = RecorderConfig()  # noqa: RUF009 (frozen)
    outputs: ExtraOutputsConfig = ExtraOutputsConfig()
    map: MapConfig = MapConfig()  # noqa: RUF009 (frozen)
    load: LoadConfig = LoadConfig()  # noqa: RUF009 (frozen)
    log: LogConfig = LogConfig()  # noqa: RUF009 (frozen)
    synthetic: SyntheticConfig = SyntheticConfig.fast()  # noqa: RUF009 (frozen)

    def __post_init__(self) -> None:
        if self.base.planar and self.T_base_camera.translation_m[2] < MIN_MOUNT_HEIGHT_M:
            raise FieldError(
                ("T_base_camera", "translation_m"),
                "a planar base needs the camera's height above the floor, the third number; "
                "kinect-vo doctor measures it",
            )

    @property
    def has_recorder(self) -> bool:
        """Whether the flight recorder runs; if unset, unless the profile is small."""
        is_enabled = self.recorder.enabled
        return self.odometry.profile != SMALL_PROFILE if is_enabled is None else is_enabled


def _reloadable_keys() -> tuple[str, ...]:
    return tuple(
        f"{table.name}.{key.name}"
        for table in typed_fields(Config)
        for key in typed_fields(table.kind)
        if key.spec.is_reloadable
    )


# Keys that take effect while the service runs; all others take effect at the next start.
RELOADABLE_KEYS = _reloadable_keys()


def read_config(path: Path | None) -> Config:
    """Read a configuration file.

    Args:
        path: The file; None: the defaults.

    Raises:
        InputError: If the file is not valid: ``FILE:LINE: key `a.b`: reason; what to do``.
    """
    return Config() if path is None else read_toml(path, Config)


@dataclass(frozen=True)
class ConfigChanges:
    """Changes by a configuration that was read again.

    Attributes:
        config: The configuration from now on: the previous one with the reloaded keys changed.
        reloaded_keys: Changed keys of `RELOADABLE_KEYS`, such as "sensor.led".
        pending_keys: Other changed keys, which take effect at the next start.
    """

    config: Config
    reloaded_keys: tuple[str, ...] = ()
    pending_keys: tuple[str, ...] = ()


def diff_configs(running: Config, requested: Config) -> ConfigChanges:
    """Find the keys that differ, and apply those that may change while the service runs.

    Args:
        running: The configuration in effect.
        requested: The configuration that was read again.
    """
    keys = tuple(_changed_keys(running, requested, ""))
    reloaded = tuple(key for key in keys if key in RELOADABLE_KEYS)
    config = running
    for key in reloaded:
        table, _, name = key.partition(".")
        config = replace_key(config, key, getattr(getattr(requested, table), name))
    pending = tuple(key for key in keys if key not in RELOADABLE_KEYS)
    return ConfigChanges(config, reloaded, pending)


class ConfigReloader:
    """Reads the configuration again, and keeps the present one.

    Attributes:
        config: The configuration in effect.
        warning: Fault of the last reload for the status; "" = none.
    """

    def __init__(self, running: Config, read: Callable[[], Config]) -> None:
        """Take the configuration in effect.

        Args:
            running: The configuration in effect.
            read: Reads the file and applies the command line, as at the start.
        """
        self.config = running
        self.warning = ""
        self._read = read

    def reload(self) -> ConfigChanges:
        """Read the file again. An invalid file is logged and changes nothing."""
        try:
            requested = self._read()
        except UserFacingError as error:
            self.warning = f"the configuration is not the one in the file: {error}"
            logger.error("%s; the previous configuration stays in effect", error)
            return ConfigChanges(self.config)
        self.warning = ""
        changes = diff_configs(self.config, requested)
        self.config = changes.config
        self._log(changes)
        return changes

    @staticmethod
    def _log(changes: ConfigChanges) -> None:
        if changes.pending_keys:
            verb = "takes" if len(changes.pending_keys) == 1 else "take"
            keys = ", ".join(changes.pending_keys)
            logger.warning("%s changed: %s effect at the next start", keys, verb)
        logger.info(
            "configuration read again; changed now: %s", ", ".join(changes.reloaded_keys) or "none"
        )


def _changed_keys(one: Any, other: Any, prefix: str) -> Iterator[str]:
    """Yield the dotted keys of the values that differ; a list is one value."""
    for field in dataclasses.fields(one):
        key = f"{prefix}{field.name}"
        before, after = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(before) and dataclasses.is_dataclass(after):
            yield from _changed_keys(before, after, f"{key}.")
        elif before != after:
            yield key


def replace_key(config: Config, key: str, value: object) -> Config:
    """Return a configuration with another value of one key, ``table.key``."""
    table, _, name = key.partition(".")
    changed: dict[str, Any] = {table: replace(getattr(config, table), **{name: value})}
    return replace(config, **changed)
