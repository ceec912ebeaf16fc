"""Rigid motions of the camera: SE(3), motion during the readout, projection with a rolling shutter.

A twist is (translation m, rotation rad), the coordinates of a motion at constant velocity; over a
second it is that velocity. Exponential and logarithm: Sola, Deray and Atchuthan, "A micro Lie
theory
for state estimation in robotics" (2018), Appendix D.

A motion (9,) is a twist, m/s and rad/s, and the angular acceleration, rad/s^2, at the frame's
stamp. Hand tremor changes the angular velocity within a frame: in 10 ms by a good part of a pixel.
The change of the linear velocity is below the sensor's noise.
"""

import numpy as np

from drivers.core.geometry import Array, inverse
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import LevelImages

MOTION_SIZE = 9
# Index of the acceleration in a motion. The unknowns of a step are a pose and a motion.
ACCELERATION_START = 6
NUM_UNKNOWNS = 6 + MOTION_SIZE
# Below this angle series are used: their next term is below double precision.
SMALL_ANGLE_RAD = 1e-3


@kernel
def se3_exp(twist: Array) -> Array:
    """4x4 rigid transform of a twist (6,)."""
    x, y, z = twist[3], twist[4], twist[5]
    squared = x * x + y * y + z * z
    angle = np.sqrt(squared)
    if angle < SMALL_ANGLE_RAD:
        sine, cosine, rest = 1 - squared / 6, 0.5 - squared / 24, 1 / 6 - squared / 120
    else:
        sine = np.sin(angle) / angle
        cosine = (1 - np.cos(angle)) / squared
        rest = (1 - sine) / squared
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    KK = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            KK[i, j] = twist[3 + i] * twist[3 + j] - (squared if i == j else 0.0)
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            T[i, j] += sine * K[i, j] + cosine * KK[i, j]
            along = (1.0 if i == j else 0.0) + cosine * K[i, j] + rest * KK[i, j]
            T[i, 3] += along * twist[j]
    return T


@inline_kernel
def transform_point(T: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Transform a point by a rigid transform 4x4.

    Args:
        T: 4x4.
        x: Position of the point, m.
        y: See x.
        z: See x.
    """
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@kernel
def compose(A: Array, B: Array) -> Array:
    """Product A B of two rigid transforms 4x4."""
    T = np.eye(4)
    for i in range(3):
        for j in range(4):
            T[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        T[i, 3] += A[i, 3]
    return T


@kernel
def invert(T: Array) -> Array:
    """Inverse of a rigid transform 4x4."""
    inverted = np.eye(4)
    for i in range(3):
        for j in range(3):
            inverted[i, j] = T[j, i]
        inverted[i, 3] = -(T[0, i] * T[0, 3] + T[1, i] * T[1, 3] + T[2, i] * T[2, 3])
    return inverted


@kernel
def se3_adjoint(T: Array) -> Array:
    """6x6 matrix that maps twists (6,) through a rigid transform 4x4."""
    Ad, (x, y, z) = np.zeros((6, 6)), (T[0, 3], T[1, 3], T[2, 3])
    for j in range(3):
        for i in range(3):
            Ad[i, j] = Ad[3 + i, 3 + j] = T[i, j]
        Ad[0, 3 + j] = y * T[2, j] - z * T[1, j]
        Ad[1, 3 + j] = z * T[0, j] - x * T[2, j]
        Ad[2, 3 + j] = x * T[1, j] - y * T[0, j]
    return Ad


@kernel
def orthonormalize_rotation(T: Array) -> Array:
    """Rigid transform 4x4 without rounding errors, see `drivers.core.geometry.orthonormalize`."""
    corrected = T.copy()
    correction = np.empty((3, 3))
    for _ in range(2):
        R = corrected[:3, :3].copy()
        for i in range(3):
            for j in range(3):
                product = R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j]
                correction[i, j] = (3.0 if i == j else 0.0) - product
        for i in range(3):
            for j in range(3):
                corrected[i, j] = 0.5 * (
                    R[i, 0] * correction[0, j]
                    + R[i, 1] * correction[1, j]
                    + R[i, 2] * correction[2, j]
                )
    return corrected


@kernel
def se3_log(T: Array) -> Array:
    """Twist (6,) of a rigid transform 4x4 with an angle below pi."""
    twist = np.empty(6)
    x, y, z = 0.5 * (T[2, 1] - T[1, 2]), 0.5 * (T[0, 2] - T[2, 0]), 0.5 * (T[1, 0] - T[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1))
    squared = angle * angle
    if angle < SMALL_ANGLE_RAD:
        scale, rest = 1 + squared / 6, 1 / 12 + squared / 720
    else:
        scale = angle / sine
        rest = (1 - 0.5 * angle * np.sin(angle) / (1 - np.cos(angle))) / squared
    x, y, z = scale * x, scale * y, scale * z
    twist[3], twist[4], twist[5] = x, y, z
    # t - w x t / 2 + rest * w x (w x t)
    tx, ty, tz = T[0, 3], T[1, 3], T[2, 3]
    cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
    twist[0] = tx - 0.5 * cx + rest * (y * cz - z * cy)
    twist[1] = ty - 0.5 * cy + rest * (z * cx - x * cz)
    twist[2] = tz - 0.5 * cz + rest * (x * cy - y * cx)
    return twist


def zero_motion() -> Array:
    """(9,) motion of a camera at rest."""
    return np.zeros(MOTION_SIZE)


@kernel
def constant_velocity_motion(velocity: Array) -> Array:
    """(9,) motion of constant velocity (6,)."""
    motion = np.zeros(MOTION_SIZE)
    for k in range(ACCELERATION_START):
        motion[k] = velocity[k]
    return motion


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


@kernel
def change_frame(motion: Array, T: Array) -> Array:
    """(9,) the same motion in the axes that T (4x4) transforms to."""
    moved = body_motion(T, motion)
    for k in range(MOTION_SIZE):
        moved[k] = -moved[k]
    return moved


@inline_kernel
def propagate_motion(motion: Array, delay_s: float) -> tuple[float, ...]:
    """Motion, 9 numbers, after a delay, by which the acceleration has changed it."""
    vx, vy, vz, bx, by, bz = motion[0], motion[1], motion[2], motion[6], motion[7], motion[8]
    wx, wy, wz = motion[3] + delay_s * bx, motion[4] + delay_s * by, motion[5] + delay_s * bz
    return vx, vy, vz, wx, wy, wz, bx, by, bz


@inline_kernel
def propagate_point(
    motion: Array | tuple[float, ...], x: float, y: float, z: float, delay_s: float
) -> tuple[float, float, float]:
    """Position of a static point in the camera's axes after a delay, to second order.

    Args:
        motion: (9,) of the camera in its own axes.
        x: Position of the point in the camera's axes, m.
        y: See x.
        z: See x.
        delay_s: The delay.
    """
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
    """Time of a row after the middle one, s.

    Args:
        v: Row.
        height: Of the image, rows.
        readout_s: Time from the first row to the last.
    """
    return (v - 0.5 * (height - 1)) * readout_s / height


@inline_kernel
def project(x: float, y: float, z: float, intrinsics: Array) -> tuple[float, float]:
    """Pixel u, v of a point in front of the camera.

    Args:
        x: Position of the point in the camera's axes, m.
        y: See x.
        z: See x.
        intrinsics: (4,) fx, fy, cx, cy.
    """
    return (
        intrinsics[0] * x / z + intrinsics[2],
        intrinsics[1] * y / z + intrinsics[3],
    )


@kernel
def project_rolling_shutter(
    position_m: Array, images: LevelImages, T_camera_keyframe: Array, motion: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Project points into the rows that see them.

    A point's row depends on its time and the time on the row: two iterations each find that of the
    color image, and from there that of the depth image. The compiler vectorizes the loop only if it
    reads contiguous columns and has no other arrays.

    Args:
        position_m: (3, N) of a keyframe's points in its axes.
        images: Images with these intrinsics and times of the rows.
        T_camera_keyframe: 4x4 at the frame's stamp.
        motion: (9,) of the camera in its own axes at the frame's stamp.

    Returns:
        (N,) pixel u and v in the color image; pixel u and v, and 1/z, in the depth image, 1/m. Of
        points behind the camera only the sign of 1/z has a meaning.
    """
    count = position_m.shape[1]
    u_color, v_color = np.empty(count), np.empty(count)
    u_depth, v_depth, inverse_z = np.empty(count), np.empty(count), np.empty(count)
    (t00, t01, t02, t03), (t10, t11, t12, t13), (t20, t21, t22, t23) = (
        _row_of(T_camera_keyframe, 0),
        _row_of(T_camera_keyframe, 1),
        _row_of(T_camera_keyframe, 2),
    )
    vx, vy, vz = motion[0], motion[1], motion[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    bx, by, bz = motion[6], motion[7], motion[8]
    intrinsics = images.depth_intrinsics
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    height = images.inverse_depth.shape[0]
    middle, row_s, skew_s = 0.5 * (height - 1), images.readout_s / height, images.skew_s
    xs, ys, zs = position_m[0], position_m[1], position_m[2]
    for n in range(count):
        px, py, pz = xs[n], ys[n], zs[n]
        x = t00 * px + t01 * py + t02 * pz + t03
        y = t10 * px + t11 * py + t12 * pz + t13
        z = t20 * px + t21 * py + t22 * pz + t23
        # Velocity of the point and half of its acceleration, as in `propagate_point`.
        ax, ay, az = wz * y - wy * z - vx, wx * z - wz * x - vy, wy * x - wx * y - vz
        hx = 0.5 * (wz * ay - wy * az + bz * y - by * z)
        hy = 0.5 * (wx * az - wz * ax + bx * z - bz * x)
        hz = 0.5 * (wy * ax - wx * ay + by * x - bx * y)
        t = (fy * y / z + cy - middle) * row_s
        t = (fy * (y + t * (ay + t * hy)) / (z + t * (az + t * hz)) + cy - middle) * row_s
        w = 1.0 / (z + t * (az + t * hz))
        v = fy * (y + t * (ay + t * hy)) * w + cy
        u_color[n], v_color[n] = fx * (x + t * (ax + t * hx)) * w + cx, v
        t = (v - middle) * row_s + skew_s
        t = (fy * (y + t * (ay + t * hy)) / (z + t * (az + t * hz)) + cy - middle) * row_s + skew_s
        w = 1.0 / (z + t * (az + t * hz))
        u_depth[n] = fx * (x + t * (ax + t * hx)) * w + cx
        v_depth[n] = fy * (y + t * (ay + t * hy)) * w + cy
        inverse_z[n] = w
    return u_color, v_color, u_depth, v_depth, inverse_z


@inline_kernel
def _row_of(T: Array, row: int) -> tuple[float, float, float, float]:
    return T[row, 0], T[row, 1], T[row, 2], T[row, 3]
