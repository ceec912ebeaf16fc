"""Which way is up in `odom`: from the gravity that the first frame carries."""

from dataclasses import dataclass, field

import numpy as np

from drivers.geometry import Array, rigid_transform, so3_exp
from drivers.gravity import Vector
from vo_service.types import LevelSource


@dataclass(frozen=True)
class GravityAlignment:
    """How `odom` lies to the base's first pose, and how that is known."""

    level_source: LevelSource = LevelSource.ASSUMED
    T_odom_start: Array = field(default_factory=lambda: np.eye(4))


def align_to_gravity(gravity_m_s2: Vector | None, T_base_camera: Array) -> GravityAlignment:
    """From gravity in camera axes: z of `odom` is up, the base starts at its origin with yaw 0.

    Without gravity the base's first pose counts as level.
    """
    if gravity_m_s2 is None:
        return GravityAlignment()
    up = -T_base_camera[:3, :3] @ np.asarray(gravity_m_s2)
    # The roll and pitch of REP 103's axes that turn this into z.
    roll_rad = np.arctan2(up[1], up[2])
    pitch_rad = np.arctan2(-up[0], np.hypot(up[1], up[2]))
    rotation = _axis_rotation(1, pitch_rad) @ _axis_rotation(0, roll_rad)
    return GravityAlignment(LevelSource.GRAVITY, rigid_transform(rotation, np.zeros(3)))


def _axis_rotation(axis: int, angle_rad: float) -> Array:
    return so3_exp(angle_rad * np.eye(3)[axis])
