"""How `odom` is kept level."""

from dataclasses import dataclass
from enum import StrEnum


class LevelSource(StrEnum):
    """Source of the up direction of `odom`."""

    FLOOR = "floor"  # the floor in the depth image
    MOUNT = "mount"  # the base drives on a level floor: `[base] planar`
    ACCELEROMETER = "accelerometer"
    ASSUMED = "assumed"  # the base's first pose counts as level


@dataclass(frozen=True)
class Level:
    """The up direction of `odom`.

    Attributes:
        source: Where it comes from.
        sigma_rad: Standard deviation of it; 0 = unknown.
        tilt_rad: Angle between the z axis of the base and up, as measured last.
        camera_height_m: Of the camera above the floor; None until a floor was seen.
        floor_z_m: Height of the floor in `odom`; None until a floor was seen, unless the base is on
            it.
        accelerometer_bias_m_s2: Bias of the accelerometer, in camera axes; None until it is known.
    """

    source: LevelSource = LevelSource.ASSUMED
    sigma_rad: float = 0.0
    tilt_rad: float = 0.0
    camera_height_m: float | None = None
    floor_z_m: float | None = None
    accelerometer_bias_m_s2: tuple[float, float, float] | None = None


UNKNOWN_LEVEL = Level()
