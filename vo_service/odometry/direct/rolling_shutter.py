"""How the camera moves while the rows of a frame are taken.

A movement (9,) is a twist, m/s and rad/s, and the angular acceleration, rad/s^2, at the instant
that everything is counted from. A hand's tremor changes how it turns within a frame: in 10 ms by a
good part of a pixel. What it changes of the place is below the sensor's noise.
"""

import numpy as np

from drivers.core.geometry import Array, adjoint, inverse
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.se3 import se3_log

MOTION_SIZE = 9
# Of the acceleration among them; and among the unknowns of a step: motion, velocity, acceleration.
ACCELERATION_START = 6
NUM_UNKNOWNS = 6 + MOTION_SIZE


def zero_motion() -> Array:
    """(9,) of a camera that stands still."""
    return np.zeros(MOTION_SIZE)


def constant_velocity_motion(velocity: Array) -> Array:
    """(9,) of a velocity (6,) that stays as it is."""
    return np.concatenate([velocity, np.zeros(3)])


def fit_through_poses(
    poses: tuple[Array, Array, Array], stamps_s: tuple[float, float, float]
) -> Array:
    """(9,) of a camera in its own axes at the second of three poses T_world_camera (4x4).

    As if the way through them were a parabola.
    """
    before, now, after = poses
    since_s, until_s = stamps_s[1] - stamps_s[0], stamps_s[2] - stamps_s[1]
    since = se3_log(inverse(before) @ now) / since_s
    until = se3_log(inverse(now) @ after) / until_s
    velocity = (until_s * since + since_s * until) / (since_s + until_s)
    acceleration = 2.0 * (until - since) / (since_s + until_s)
    return np.concatenate([velocity, acceleration[3:]])


def change_frame(motion: Array, T: Array) -> Array:
    """(9,) the same movement in the axes that T (4x4) leads to."""
    Ad = adjoint(T)
    turned = Ad[3:, 3:] @ motion[ACCELERATION_START:]
    return np.concatenate([Ad @ motion[:ACCELERATION_START], turned])


@kernel
def body_motion(T_camera_keyframe: Array, motion: Array) -> Array:
    """The camera's movement in its own axes (9,), of that of the motion in the keyframe's axes.

    The points move through the camera's axes as the camera does not: minus the adjoint.
    """
    T = T_camera_keyframe
    own = np.empty(MOTION_SIZE)
    for first in (0, 3, 6):
        x, y, z = motion[first], motion[first + 1], motion[first + 2]
        for i in range(3):
            own[first + i] = -(T[i, 0] * x + T[i, 1] * y + T[i, 2] * z)
    tx, ty, tz = T[0, 3], T[1, 3], T[2, 3]
    own[0] += ty * own[5] - tz * own[4]
    own[1] += tz * own[3] - tx * own[5]
    own[2] += tx * own[4] - ty * own[3]
    return own


@inline_kernel
def propagate_motion(motion: Array, delay_s: float) -> Array:
    """(9,) the movement after some time: it turns otherwise by then."""
    then = motion.copy()
    for i in range(3):
        then[3 + i] += delay_s * motion[ACCELERATION_START + i]
    return then


@inline_kernel
def propagate_point(
    motion: Array, x: float, y: float, z: float, delay_s: float
) -> tuple[float, float, float]:
    """Where a standing point is in the camera's axes after some time, to the second order."""
    vx, vy, vz = motion[0], motion[1], motion[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    bx, by, bz = motion[6], motion[7], motion[8]
    # What the point does in the camera's axes: minus (v + w x p), which itself turns with the axes,
    # and faster by b.
    ax, ay, az = wz * y - wy * z - vx, wx * z - wz * x - vy, wy * x - wx * y - vz
    half = 0.5 * delay_s * delay_s
    return (
        x + delay_s * ax + half * (wz * ay - wy * az + bz * y - by * z),
        y + delay_s * ay + half * (wx * az - wz * ax + bx * z - bz * x),
        z + delay_s * az + half * (wy * ax - wx * ay + by * x - bx * y),
    )


# A row's time depends on where the point is, and that on the time: so many rounds settle it.
ITERATIONS = 2


@inline_kernel
def row_time(v: float, height: int, readout_s: float) -> float:
    """When a row is taken, after the middle one."""
    return (v - 0.5 * (height - 1)) * readout_s / height


@inline_kernel
def project(x: float, y: float, z: float, intrinsics: Array) -> tuple[float, float]:
    """Pixel u, v of a point in front of the camera."""
    return (
        intrinsics[0] * x / z + intrinsics[2],
        intrinsics[1] * y / z + intrinsics[3],
    )


@inline_kernel
def project_rolling_shutter(
    motion: Array,
    x: float,
    y: float,
    z: float,
    intrinsics: Array,
    height: int,
    readout_s: float,
    skew_s: float,
) -> tuple[float, float, float]:
    """Pixel u, v and depth of a point in the row that sees it.

    movement  of the camera in its own axes, see `movement`
    late_s    the middle row after the instant that the point is given for
    """
    u, v = project(x, y, z, intrinsics)
    z_then = z
    for _ in range(ITERATIONS):
        delay_s = skew_s + row_time(v, height, readout_s)
        x_then, y_then, z_then = propagate_point(motion, x, y, z, delay_s)
        u, v = project(x_then, y_then, z_then, intrinsics)
    return u, v, z_then
