"""Motion of the camera during the readout of a frame, and projection with a rolling shutter.

A motion (9,) is a twist, m/s and rad/s, and the angular acceleration, rad/s^2, at the frame's
stamp. Hand tremor changes the angular velocity within a frame: in 10 ms by a good part of a pixel.
The change of the linear velocity is below the sensor's noise.
"""

import numpy as np

from drivers.core.geometry import Array, adjoint, inverse
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.parameters import ROW_TIME_ITERATIONS
from vo_service.odometry.direct.se3 import se3_log

MOTION_SIZE = 9
# Index of the acceleration in a motion. The unknowns of a step are a pose and a motion.
ACCELERATION_START = 6
NUM_UNKNOWNS = 6 + MOTION_SIZE


def zero_motion() -> Array:
    """(9,) motion of a camera at rest."""
    return np.zeros(MOTION_SIZE)


def constant_velocity_motion(velocity: Array) -> Array:
    """(9,) motion of constant velocity (6,)."""
    return np.concatenate([velocity, np.zeros(3)])


def fit_through_poses(
    poses: tuple[Array, Array, Array], stamps_s: tuple[float, float, float]
) -> Array:
    """(9,) motion of a camera in its own axes at the second of three poses T_world_camera (4x4).

    The trajectory through them is taken as a parabola.
    """
    before, now, after = poses
    since_s, until_s = stamps_s[1] - stamps_s[0], stamps_s[2] - stamps_s[1]
    since = se3_log(inverse(before) @ now) / since_s
    until = se3_log(inverse(now) @ after) / until_s
    velocity = (until_s * since + since_s * until) / (since_s + until_s)
    acceleration = 2.0 * (until - since) / (since_s + until_s)
    return np.concatenate([velocity, acceleration[3:]])


def change_frame(motion: Array, T: Array) -> Array:
    """(9,) the same motion in the axes that T (4x4) transforms to."""
    Ad = adjoint(T)
    turned = Ad[3:, 3:] @ motion[ACCELERATION_START:]
    return np.concatenate([Ad @ motion[:ACCELERATION_START], turned])


@kernel
def body_motion(T_camera_keyframe: Array, motion: Array) -> Array:
    """(9,) motion of the camera in its own axes, from that of the points in the keyframe's axes.

    The points move through the camera's axes opposite to the camera: minus the adjoint.
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
    """(9,) motion after a delay, by which the acceleration has changed it."""
    then = motion.copy()
    for i in range(3):
        then[3 + i] += delay_s * motion[ACCELERATION_START + i]
    return then


@inline_kernel
def propagate_point(
    motion: Array, x: float, y: float, z: float, delay_s: float
) -> tuple[float, float, float]:
    """Position of a static point in the camera's axes after a delay, to second order."""
    vx, vy, vz = motion[0], motion[1], motion[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    bx, by, bz = motion[6], motion[7], motion[8]
    # The point's velocity in the camera's axes is -(v + w x p); w grows by b.
    ax, ay, az = wz * y - wy * z - vx, wx * z - wz * x - vy, wy * x - wx * y - vz
    half = 0.5 * delay_s * delay_s
    return (
        x + delay_s * ax + half * (wz * ay - wy * az + bz * y - by * z),
        y + delay_s * ay + half * (wx * az - wz * ax + bx * z - bz * x),
        z + delay_s * az + half * (wy * ax - wx * ay + by * x - bx * y),
    )


@inline_kernel
def row_time(v: float, height: int, readout_s: float) -> float:
    """Time of a row after the middle one, s."""
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
    """Project a point into the row that sees it.

    Args:
        motion: (9,) of the camera in its own axes.
        x: Position of the point in the camera's axes, m.
        y: See x.
        z: See x.
        intrinsics: (4,) fx, fy, cx, cy.
        height: Of the image, rows.
        readout_s: Time from the first row to the last.
        skew_s: Time of the middle row after the instant of the point's position.

    Returns:
        Pixel u, v and depth.
    """
    u, v = project(x, y, z, intrinsics)
    z_then = z
    for _ in range(ROW_TIME_ITERATIONS):
        delay_s = skew_s + row_time(v, height, readout_s)
        x_then, y_then, z_then = propagate_point(motion, x, y, z, delay_s)
        u, v = project(x_then, y_then, z_then, intrinsics)
    return u, v, z_then
