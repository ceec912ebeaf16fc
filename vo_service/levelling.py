"""Which way is up in `odom`: from the gravity that the first frame carries."""

from dataclasses import dataclass, field

import numpy as np

from drivers.geometry import Array, rigid_transform, rotation_from_vector
from drivers.gravity import Vector
from vo_service.types import Level


@dataclass(frozen=True)
class Levelling:
    """How `odom` lies to the base's first pose, and how that is known."""

    level: Level = Level.ASSUMED
    T_odom_start: Array = field(default_factory=lambda: np.eye(4))


def level_by(gravity_m_s2: Vector | None, T_base_camera: Array) -> Levelling:
    """From gravity in camera axes: z of `odom` is up, the base starts at its origin with yaw 0.

    Without gravity the base's first pose counts as level.
    """
    if gravity_m_s2 is None:
        return Levelling()
    up = -T_base_camera[:3, :3] @ np.asarray(gravity_m_s2)
    # The roll and pitch of REP 103's axes that turn this into z.
    roll_rad = np.arctan2(up[1], up[2])
    pitch_rad = np.arctan2(-up[0], np.hypot(up[1], up[2]))
    rotation = _about(1, pitch_rad) @ _about(0, roll_rad)
    return Levelling(Level.GRAVITY, rigid_transform(rotation, np.zeros(3)))


def _about(axis: int, angle_rad: float) -> Array:
    return rotation_from_vector(angle_rad * np.eye(3)[axis])
