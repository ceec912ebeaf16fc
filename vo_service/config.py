"""The configuration file: one dataclass a table, one field a key; `config/kinect.toml` has all."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core.config import config_field, read_toml
from drivers.core.geometry import T_BODY_CAMERA, Array, transform_from_pose
from drivers.registry import CAMERA_USAGES
from drivers.sensor_config import SensorConfig
from drivers.synthetic.config import SyntheticConfig
from vo_service.config_tables import (
    CommandConfig,
    LoadConfig,
    LogConfig,
    MapConfig,
    RecorderConfig,
    RerunConfig,
    Ros2Config,
    ZenohConfig,
)
from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.registry import (
    DEFAULT_METHOD,
    MAX_FEATURES,
    METHODS,
    MIN_FEATURES,
    make_odometry,
)
from vo_service.types import Odometry


@dataclass(frozen=True)
class CameraConfig:
    """`[camera]`: where frames come from."""

    source: str = config_field("synthetic", f"one of {', '.join(CAMERA_USAGES.values())}")
    file: Path | None = config_field(None, "camera file: intrinsics, distortion, registration")
    stamp_offset_s: float = config_field(
        0.0, "added to every published stamp, seconds", minimum=-1.0, maximum=1.0
    )

    def __post_init__(self) -> None:
        if self.source.partition(":")[0] not in CAMERA_USAGES:
            raise ValueError(
                f"source {self.source!r} is unknown; use one of {', '.join(CAMERA_USAGES.values())}"
            )


@dataclass(frozen=True)
class OdometryConfig:
    """`[odometry]`: how motion is estimated."""

    method: str = config_field(DEFAULT_METHOD, f"one of {', '.join(METHODS)}")
    feature_count: int = config_field(
        1000, "features to find in a frame", minimum=MIN_FEATURES, maximum=MAX_FEATURES
    )
    upright: bool = config_field(False, "true for a camera that never rolls: faster, more matches")

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method {self.method!r} is unknown; use one of {', '.join(METHODS)}")

    def make_odometry(self, timer: StageTimer) -> Odometry:
        """Make the odometry that the table describes."""
        return make_odometry(
            self.method, feature_count=self.feature_count, upright=self.upright, timer=timer
        )


@dataclass(frozen=True)
class MountingConfig:
    """`[T_base_camera]`: where the camera's optical frame is in the robot's base_link."""

    translation_m: tuple[float, float, float] = config_field(
        (0.0, 0.0, 0.0), "x y z in base_link, m"
    )
    quaternion_xyzw: tuple[float, float, float, float] = config_field(
        (-0.5, 0.5, -0.5, 0.5), "optical axes in base_link; the default looks straight ahead"
    )

    def __post_init__(self) -> None:
        if abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 1e-2:
            raise ValueError("quaternion_xyzw must have length 1, as x y z w")

    @property
    def T_base_camera(self) -> Array:
        """4x4; maps optical camera coordinates to base_link."""
        if self == MountingConfig():
            return T_BODY_CAMERA
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class Config:
    """A whole configuration file; every table and key may be left out."""

    camera: CameraConfig = CameraConfig()
    sensor: SensorConfig = SensorConfig()  # noqa: RUF009 (frozen)
    odometry: OdometryConfig = OdometryConfig()
    T_base_camera: MountingConfig = MountingConfig()
    zenoh: ZenohConfig = ZenohConfig()  # noqa: RUF009 (frozen)
    commands: CommandConfig = CommandConfig()  # noqa: RUF009 (frozen)
    ros2: Ros2Config = Ros2Config()  # noqa: RUF009 (frozen)
    rerun: RerunConfig = RerunConfig()  # noqa: RUF009 (frozen)
    recorder: RecorderConfig = RecorderConfig()  # noqa: RUF009 (frozen)
    map: MapConfig = MapConfig()  # noqa: RUF009 (frozen)
    load: LoadConfig = LoadConfig()  # noqa: RUF009 (frozen)
    log: LogConfig = LogConfig()  # noqa: RUF009 (frozen)
    synthetic: SyntheticConfig = SyntheticConfig.fast()  # noqa: RUF009 (frozen)


def read_config(path: Path | None) -> Config:
    """Read a configuration file; without one, everything has its default.

    Raises InputError ``FILE:LINE: key `a.b`: reason; what to do``.
    """
    return Config() if path is None else read_toml(path, Config)
