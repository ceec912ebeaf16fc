"""Normal equations of the sensor's calibration: readout time, delay of depth, focal length.

A wrong timing leaves residuals that grow with the velocity and with a row's distance from the
middle one. A wrong focal length magnifies the keyframe's points and the frame alike, and leaves
residuals as soon as the points have moved in the image. Three more columns of the normal equations
measure them; pose, gain and a turn of the depth camera are marginalized, as they are estimated with
them. Depth may ask for another focal length than brightness: that difference is an unknown of its
own, so that brightness alone gives the focal length.

Rolling shutter as in Kerl, Stueckler and Cremers, "Dense Continuous-Time Tracking and Mapping with
Rolling Shutter RGB-D Cameras" (ICCV 2015); online estimate of a delay as in Qin and Shen, "Online
Temporal Calibration for Monocular Visual-Inertial Systems" (IROS 2018).
"""

from typing import NamedTuple

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.factor import (
    Jacobian,
    brightness_residual,
    jacobian,
    student_curvature,
    student_weight,
)
from vo_service.odometry.direct.motion import (
    body_motion,
    constant_velocity_motion,
    invert,
    se3_adjoint,
)
from vo_service.odometry.direct.parameters import (
    CALIBRATION_POINT_STRIDE,
    CALIBRATION_STEP_RATIO,
    KEYFRAME_CALIBRATION_SIGMAS,
    TURN_INFORMATION,
)
from vo_service.odometry.direct.points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_U,
    SAMPLE_V,
)
from vo_service.odometry.direct.residuals import (
    GAIN,
    WEIGHT_BRIGHTNESS,
    residual_variances,
)
from vo_service.odometry.direct.small_matrices import add_residual, invert_cholesky, marginalize

# The unknowns that are kept: readout and delay, s; logarithm of the ratio of the focal length to
# that of the frames; the same by depth minus that by brightness.
READOUT, DELAY, FOCAL, DISAGREEMENT, NUM_KEPT = range(5)
# The timing; with the focal length, all that is used.
TIMING, USED = slice(READOUT, DELAY + 1), slice(READOUT, FOCAL + 1)
# Before them: pose (6), gain, turn of the depth camera (2).
FIRST_TURN, FIRST_KEPT = 7, 9
NUM_UNKNOWNS = FIRST_KEPT + NUM_KEPT
# Columns of the twists of a view: of the keyframe's points in the keyframe's axes, m/s and rad/s,
# while the frame was taken; what is added to that by which the residuals were corrected, to correct
# them by none; both while the keyframe was taken; of a camera that turns about its own x and y axis
# at 1 rad/s, at the frame (2) and at the keyframe (2).
VELOCITY, VELOCITY_USED, KEYFRAME_VELOCITY, KEYFRAME_VELOCITY_USED = range(4)
TURNS, KEYFRAME_TURNS, NUM_TWISTS = 4, 6, 8


class CalibrationView(NamedTuple):
    """What the equations need of a view, beside its points and samples.

    Attributes:
        T_camera_keyframe: 4x4.
        motion: (9,) of the keyframe's points that the frame was aligned with.
        velocity: (6,) of the frame's camera in its own axes, m/s and rad/s.
        keyframe_motion: (9,) of the camera that the keyframe was made with, in its own axes.
        keyframe_velocity: (6,) of the keyframe's camera in its own axes.
        calibration: (3,) that the frame was aligned with.
        keyframe_timing: (2,) that the keyframe was made with; its focal length is the frame's.
        intrinsics: (4,) of the whole image.
        height: Rows of the whole image.
    """

    T_camera_keyframe: Array
    motion: Array
    velocity: Array
    keyframe_motion: Array
    keyframe_velocity: Array
    calibration: Array
    keyframe_timing: Array
    intrinsics: Array
    height: int


@kernel
def measure_calibration(
    points: Array,
    samples: Array,
    cell_weights: Array,
    residual_model: Array,
    view: CalibrationView,
) -> Array:
    """Information of one view about the calibration.

    Args:
        points: (N, COLUMNS) of the keyframe's finest level.
        samples: (N, COLUMNS) of the view.
        cell_weights: (2, CELLS).
        residual_model: (6,), see `residuals`.
        view: The view's velocities and calibration.

    Returns:
        (4, 5) information [A b]: A x = b at the best calibration x.
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    row, gain = np.zeros(NUM_UNKNOWNS), residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    twists = _make_twists(view)
    # Fields of a tuple cost time in a loop.
    T, intrinsics, height = view.T_camera_keyframe, view.intrinsics, view.height
    camera_position = invert(T)[:3, 3].copy()
    frame, keyframe = view.calibration, view.keyframe_timing
    timings = frame[READOUT], frame[DELAY], keyframe[READOUT], keyframe[DELAY]
    middle_row = 0.5 * (height - 1)
    for i in range(0, len(points), CALIBRATION_POINT_STRIDE):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        cell = int(samples[i, SAMPLE_CELL])
        v_keyframe = intrinsics[1] * points[i, 1] / points[i, 2] + intrinsics[3]
        # Times of the rows as shares of the readout.
        shares = (samples[i, SAMPLE_V] - middle_row) / height, (v_keyframe - middle_row) / height
        magnified = _magnify(points[i], samples[i, SAMPLE_U], samples[i, SAMPLE_V], intrinsics, T)
        J_depth = jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0)
        if points[i, HAS_TEXTURE] > 0:
            residual = brightness_residual(brightness, points[i, POINT_BRIGHTNESS], gain)
            sample_variance = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            w = student_weight(residual, sample_variance)
            w *= residual_model[WEIGHT_BRIGHTNESS] * cell_weights[0, cell]
            curvature = w * student_curvature(residual, sample_variance)
            J = jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain)
            # Only parallax shows an error of the point's depth in its brightness.
            by_depth = -points[i, 2] * _along(J, camera_position)
            row[6] = -points[i, POINT_BRIGHTNESS]
            J_delay = _scaled(J_depth, by_depth)
            linear = _fill_row(J, J_delay, 0.0, twists, shares, timings, row)
            row[FIRST_KEPT + FOCAL] = _along(J, magnified)
            row[FIRST_KEPT + DISAGREEMENT] = 0.0
            linear -= CALIBRATION_STEP_RATIO * frame[FOCAL] * row[FIRST_KEPT + FOCAL]
            add_residual(H, g, row, curvature, w * residual + curvature * linear)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = student_weight(depth, variance_depth) * cell_weights[1, cell]
            curvature = w * student_curvature(depth, variance_depth)
            row[6] = 0.0
            J_delay = _scaled(J_depth, -1.0)
            linear = _fill_row(J_depth, J_delay, 1.0, twists, shares, timings, row)
            row[FIRST_KEPT + FOCAL] = row[FIRST_KEPT + DISAGREEMENT] = _along(J_depth, magnified)
            linear -= CALIBRATION_STEP_RATIO * frame[FOCAL] * row[FIRST_KEPT + FOCAL]
            add_residual(H, g, row, curvature, w * depth + curvature * linear)
    for k in range(FIRST_TURN, FIRST_KEPT):
        H[k, k] += TURN_INFORMATION
    information = marginalize(H, g, NUM_KEPT)
    information[:, :NUM_KEPT] *= CALIBRATION_STEP_RATIO
    return information


@kernel
def _make_twists(view: CalibrationView) -> Array:
    """(6, TWISTS) of a view."""
    T_keyframe_camera = invert(view.T_camera_keyframe)
    Ad, twists = se3_adjoint(T_keyframe_camera), np.zeros((6, NUM_TWISTS))
    in_keyframe = body_motion(T_keyframe_camera, constant_velocity_motion(view.velocity))
    for k in range(6):
        velocity, keyframe_velocity = in_keyframe[k], -view.keyframe_velocity[k]
        twists[k, VELOCITY], twists[k, KEYFRAME_VELOCITY] = velocity, keyframe_velocity
        # The alignment's own velocity, to the view's; its effect by the share of a step.
        share = 1.0 - CALIBRATION_STEP_RATIO
        twists[k, VELOCITY_USED] = share * velocity - view.motion[k]
        twists[k, KEYFRAME_VELOCITY_USED] = share * keyframe_velocity + view.keyframe_motion[k]
        for turn in range(2):
            twists[k, TURNS + turn] = -Ad[k, 3 + turn]
    for turn in range(2):
        twists[3 + turn, KEYFRAME_TURNS + turn] = -1.0
    return twists


@inline_kernel
def _along(J: Jacobian, motion: Array | tuple[float, float, float]) -> float:
    """Change of a residual with derivative J by a motion (3,) of the point, m."""
    return float(J[0] * motion[0] + J[1] * motion[1] + J[2] * motion[2])


@inline_kernel
def _change(J: Jacobian, twists: Array, n: int) -> float:
    """Change of a residual with derivative J by one of the twists (6, TWISTS)."""
    return float(
        J[0] * twists[0, n]
        + J[1] * twists[1, n]
        + J[2] * twists[2, n]
        + J[3] * twists[3, n]
        + J[4] * twists[4, n]
        + J[5] * twists[5, n]
    )


@kernel
def _fill_row(
    J: Jacobian,
    J_delay: Jacobian,
    is_depth: float,
    twists: Array,
    shares: tuple[float, float],
    timings: tuple[float, float, float, float],
    row: Array,
) -> float:
    """Fill in the derivatives of a residual by pose, turn and timing.

    Args:
        J: Derivative of the residual by a motion of the point.
        J_delay: The same by a motion of the keyframe's depth camera before the point was read.
        is_depth: 1 for depth, 0 for brightness.
        twists: (6, TWISTS) of the view.
        shares: Times of the frame's and of the keyframe's row as shares of the readout.
        timings: Readout and delay of the frame, then of the keyframe.
        row: (UNKNOWNS,) the derivatives.

    Returns:
        What is added to the residual to make it that of zero timing and of the view's velocities.
    """
    (share, keyframe_share), (readout, delay, keyframe_readout, keyframe_delay) = shares, timings
    velocity = _change(J, twists, VELOCITY)
    for k in range(6):
        row[k] = J[k]
    for k in range(2):
        turn = is_depth * _change(J, twists, TURNS + k)
        row[FIRST_TURN + k] = turn + _change(J_delay, twists, KEYFRAME_TURNS + k)
    row[FIRST_KEPT + READOUT] = share * velocity - keyframe_share * _change(
        J, twists, KEYFRAME_VELOCITY
    )
    row[FIRST_KEPT + DELAY] = is_depth * velocity + _change(J_delay, twists, KEYFRAME_VELOCITY)
    return float(
        (share * readout + is_depth * delay) * _change(J, twists, VELOCITY_USED)
        - keyframe_share * keyframe_readout * _change(J, twists, KEYFRAME_VELOCITY_USED)
        + keyframe_delay * _change(J_delay, twists, KEYFRAME_VELOCITY_USED)
    )


@inline_kernel
def _scaled(J: Jacobian, scale: float) -> Jacobian:
    return scale * J[0], scale * J[1], scale * J[2], scale * J[3], scale * J[4], scale * J[5]


@inline_kernel
def _magnify(
    point: Array, u: float, v: float, intrinsics: Array, T_camera_keyframe: Array
) -> tuple[float, float, float]:
    """Motion of a point in the keyframe's axes, m, by the logarithm of the focal length.

    It moves sideways in the frame's axes, where it is seen at (u, v), and in the keyframe's.
    """
    T, (x, y, z) = T_camera_keyframe, (point[0], point[1], point[2])
    z_there = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    x_there = (u - intrinsics[2]) / intrinsics[0] * z_there
    y_there = (v - intrinsics[3]) / intrinsics[1] * z_there
    return (
        T[0, 0] * x_there + T[1, 0] * y_there - x,
        T[0, 1] * x_there + T[1, 1] * y_there - y,
        T[0, 2] * x_there + T[1, 2] * y_there,
    )


# Information of the error that the views of a keyframe share.
SHARED_INFORMATION = np.diag(np.array(KEYFRAME_CALIBRATION_SIGMAS) ** -2.0)
# Added to the diagonal of an information before it is inverted, relative to it, and 1/s^2.
RELATIVE_REGULARIZATION, REGULARIZATION = 1e-9, 1e-3


@kernel
def solve_information(information: Array) -> tuple[Array, Array]:
    """(N,) best state and its (N, N) covariance, of an information (N, N + 1)."""
    n = len(information)
    A = information[:, :n].copy()
    for k in range(n):
        A[k, k] += RELATIVE_REGULARIZATION * A[k, k] + REGULARIZATION
    covariance, state = invert_cholesky(A), np.zeros(n)
    # Not `@`: a kernel with it loads SciPy's linear algebra.
    for i in range(n):
        for k in range(n):
            state[i] += covariance[i, k] * information[k, n]
    return state, covariance


@kernel
def limit_information(information: Array, error: float) -> Array:
    """(4, 5) information of a keyframe's views; the error that they share is added.

    Args:
        information: (4, 5) sum over the views.
        error: Squared error of a view, relative to its information.
    """
    n, views = len(information), information / error
    # The error is one more unknown of the same views, and is marginalized.
    inverse, limited = invert_cholesky(views[:, :n] + SHARED_INFORMATION), views.copy()
    for i in range(n):
        for j in range(n + 1):
            for k in range(n):
                for m in range(n):
                    limited[i, j] -= views[i, k] * inverse[k, m] * views[m, j]
    return limited
