"""The configuration file: one dataclass a table, one field a key; `config/kinect.toml` has all."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.geometry import T_BODY_CAMERA, Array, transform_from_pose
from drivers.sensor_settings import SensorSettings
from drivers.strict_toml import read_toml, setting
from drivers.synthetic.config import SyntheticConfig
from vo_service.cameras import USAGES
from vo_service.methods import DEFAULT_METHOD, METHODS, FeatureSettings
from vo_service.odometry.stopwatch import Stopwatch
from vo_service.settings import (
    CommandSettings,
    LoadSettings,
    LogSettings,
    MapSettings,
    RecorderSettings,
    RerunSettings,
    Ros2Settings,
    ZenohConfig,
)
from vo_service.types import Odometry


@dataclass(frozen=True)
class CameraSettings:
    """`[camera]`: where frames come from."""

    source: str = setting("synthetic", f"one of {', '.join(USAGES.values())}")
    file: Path | None = setting(None, "camera file: intrinsics, distortion, registration")
    stamp_offset_s: float = setting(
        0.0, "added to every published stamp, seconds", low=-1.0, high=1.0
    )

    def __post_init__(self) -> None:
        if self.source.partition(":")[0] not in USAGES:
            raise ValueError(
                f"source {self.source!r} is unknown; use one of {', '.join(USAGES.values())}"
            )


@dataclass(frozen=True)
class OdometrySettings:
    """`[odometry]`: how motion is estimated."""

    method: str = setting(DEFAULT_METHOD, f"one of {', '.join(METHODS)}")
    feature_count: int = setting(1000, "features to find in a frame", low=50, high=5000)
    upright: bool = setting(False, "true for a camera that never rolls: faster, more matches")

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method {self.method!r} is unknown; use one of {', '.join(METHODS)}")


@dataclass(frozen=True)
class MountingSettings:
    """`[T_base_camera]`: where the camera's optical frame is in the robot's base_link."""

    translation_m: tuple[float, float, float] = setting((0.0, 0.0, 0.0), "x y z in base_link, m")
    quaternion_xyzw: tuple[float, float, float, float] = setting(
        (-0.5, 0.5, -0.5, 0.5), "optical axes in base_link; the default looks straight ahead"
    )

    def __post_init__(self) -> None:
        if abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 1e-2:
            raise ValueError("quaternion_xyzw must have length 1, as x y z w")

    @property
    def T_base_camera(self) -> Array:
        """4x4; maps optical camera coordinates to base_link."""
        if self == MountingSettings():
            return T_BODY_CAMERA
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class Config:
    """A whole configuration file; every table and key may be left out."""

    camera: CameraSettings = CameraSettings()
    sensor: SensorSettings = SensorSettings()  # noqa: RUF009 (frozen)
    odometry: OdometrySettings = OdometrySettings()
    T_base_camera: MountingSettings = MountingSettings()
    zenoh: ZenohConfig = ZenohConfig()  # noqa: RUF009 (frozen)
    commands: CommandSettings = CommandSettings()  # noqa: RUF009 (frozen)
    ros2: Ros2Settings = Ros2Settings()  # noqa: RUF009 (frozen)
    rerun: RerunSettings = RerunSettings()  # noqa: RUF009 (frozen)
    recorder: RecorderSettings = RecorderSettings()  # noqa: RUF009 (frozen)
    map: MapSettings = MapSettings()  # noqa: RUF009 (frozen)
    load: LoadSettings = LoadSettings()  # noqa: RUF009 (frozen)
    log: LogSettings = LogSettings()  # noqa: RUF009 (frozen)
    synthetic: SyntheticConfig = SyntheticConfig.light()  # noqa: RUF009 (frozen)


def make_odometry(settings: OdometrySettings, stopwatch: Stopwatch) -> Odometry:
    """The estimator that the settings name."""
    features = FeatureSettings(settings.feature_count, settings.upright)
    return METHODS[settings.method](features, stopwatch)


def read_config(path: Path | None) -> Config:
    """Read a configuration file; without one, everything has its default.

    Raises InputError ``FILE:LINE: key `a.b`: reason; what to do``.
    """
    return Config() if path is None else read_toml(path, Config)
