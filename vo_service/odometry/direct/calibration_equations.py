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
    student_weight,
)
from vo_service.odometry.direct.motion import (
    body_motion,
    constant_velocity_motion,
    invert,
    se3_adjoint,
)
from vo_service.odometry.direct.parameters import (
    CALIBRATION_STRIDE,
    KEYFRAME_CALIBRATION_SIGMAS,
    TURN_INFORMATION,
)
from vo_service.odometry.direct.points import (
    Points,
)
from vo_service.odometry.direct.residuals import ResidualModel
from vo_service.odometry.direct.samples import Samples
from vo_service.odometry.direct.small_matrices import add_residual, invert_cholesky, marginalize

# The unknowns that are kept: readout and delay, s; logarithm of the ratio of the focal length to
# that of the frames; the same by depth minus that by brightness.
READOUT, DELAY, FOCAL, DISAGREEMENT, NUM_KEPT = range(5)
# The timing; with the focal length, all that is used.
TIMING, USED = slice(READOUT, DELAY + 1), slice(READOUT, FOCAL + 1)
# Before them: pose (6), gain, turn of the depth camera (2).
FIRST_TURN, FIRST_KEPT = 7, 9
NUM_UNKNOWNS = FIRST_KEPT + NUM_KEPT


class CalibrationView(NamedTuple):
    """What the equations need of a view, beside its points and samples.

    Attributes:
        T_camera_keyframe: 4x4.
        motion: (9,) of the keyframe's points that the frame was aligned with.
        velocity: (6,) of the frame's camera in its own axes, m/s and rad/s.
        keyframe_motion: (9,) of the camera that the keyframe was made with, in its own axes.
        keyframe_velocity: (6,) of the keyframe's camera in its own axes.
        calibration: (3,) that both were made with.
        intrinsics: (4,) of the whole image.
        height: Rows of the whole image.
    """

    T_camera_keyframe: Array
    motion: Array
    velocity: Array
    keyframe_motion: Array
    keyframe_velocity: Array
    calibration: Array
    intrinsics: Array
    height: int


@kernel
def measure_calibration(
    points: Points,
    samples: Samples,
    cell_weights: Array,
    residual_model: ResidualModel,
    view: CalibrationView,
) -> Array:
    """Information of one view about the calibration.

    Args:
        points: Of the keyframe's finest level.
        samples: Of the view.
        cell_weights: (2, CELLS).
        residual_model: Of the view.
        view: The view's velocities and calibration.

    Returns:
        (4, 5) information [A b]: A x = b at the best calibration x.
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    row, gain = np.zeros(NUM_UNKNOWNS), residual_model.gain
    variance = residual_model.sigma_brightness**2
    variance_depth = residual_model.sigma_depth**2
    # Fields of a tuple cost time in a loop.
    T, intrinsics, height = view.T_camera_keyframe, view.intrinsics, view.height
    T_keyframe_camera = invert(T)
    Ad, camera_position = se3_adjoint(T_keyframe_camera), T_keyframe_camera[:3, 3].copy()
    # Twists of the keyframe's points in its axes: of the frame, and of the keyframe; then those
    # that frame and keyframe have been corrected with.
    moved = body_motion(T_keyframe_camera, constant_velocity_motion(view.velocity))
    moved_keyframe, moved_by = -view.keyframe_velocity, (view.motion, -view.keyframe_motion)
    calibration, middle_row = view.calibration, 0.5 * (height - 1)
    position_m = points.position_m
    for i in range(0, len(points.brightness), CALIBRATION_STRIDE):
        u, v, depth_m = samples.u[i], samples.v[i], position_m[2, i]
        if np.isnan(samples.brightness[i]):
            continue
        v_keyframe = intrinsics[1] * position_m[1, i] / depth_m + intrinsics[3]
        # Times of the rows as shares of the readout.
        shares = (v - middle_row) / height, (v_keyframe - middle_row) / height
        magnified = _magnify(position_m, i, u, v, intrinsics, T)
        J_depth = jacobian(position_m, points.depth_gradient, i, 1.0)
        for is_depth in range(2):
            weight = cell_weights[is_depth, samples.cell[i]]
            if is_depth:
                residual, J, by_depth = samples.depth_residual[i], J_depth, -1.0
                if np.isnan(residual) or not points.has_shape[i]:
                    continue
                weight *= student_weight(residual, variance_depth)
                row[6] = 0.0
            else:
                if not points.has_texture[i]:
                    continue
                residual = brightness_residual(samples.brightness[i], points.brightness[i], gain)
                J = jacobian(position_m, points.brightness_gradient, i, gain)
                # Only parallax shows an error of the point's depth in its brightness.
                by_depth = -depth_m * _along(J, camera_position)
                weight *= residual_model.brightness_weight * student_weight(
                    residual, variance + points.brightness_variance[i]
                )
                row[6] = -points.brightness[i]
            for k in range(6):
                row[k] = J[k]
            # The depth camera turns about its x and y axis, at the frame and at the keyframe.
            for k in range(2):
                row[FIRST_TURN + k] = -by_depth * J_depth[3 + k]
                if is_depth:
                    for m in range(6):
                        row[FIRST_TURN + k] -= J[m] * Ad[m, 3 + k]
            row[FIRST_KEPT + READOUT], row[FIRST_KEPT + DELAY] = _by_timing(
                J, J_depth, by_depth, is_depth, shares, moved, moved_keyframe
            )
            row[FIRST_KEPT + FOCAL] = _along(J, magnified)
            row[FIRST_KEPT + DISAGREEMENT] = is_depth * row[FIRST_KEPT + FOCAL]
            # To the residual without any correction.
            by_readout, by_delay = _by_timing(
                J, J_depth, by_depth, is_depth, shares, moved_by[0], moved_by[1]
            )
            residual -= calibration[READOUT] * by_readout + calibration[DELAY] * by_delay
            residual -= calibration[FOCAL] * row[FIRST_KEPT + FOCAL]
            add_residual(H, g, row, weight, weight * residual)
    for k in range(FIRST_TURN, FIRST_KEPT):
        H[k, k] += TURN_INFORMATION
    return marginalize(H, g, NUM_KEPT)


@inline_kernel
def _along(J: Jacobian, motion: Array | tuple[float, float, float]) -> float:
    """Change of a residual with derivative J by a motion (3,) of the point, m."""
    return float(J[0] * motion[0] + J[1] * motion[1] + J[2] * motion[2])


@inline_kernel
def _by_twist(J: Jacobian, twist: Array) -> float:
    """Change of a residual with derivative J by a twist, the first six of an array."""
    return float(
        J[0] * twist[0]
        + J[1] * twist[1]
        + J[2] * twist[2]
        + J[3] * twist[3]
        + J[4] * twist[4]
        + J[5] * twist[5]
    )


@inline_kernel
def _by_timing(
    J: Jacobian,
    J_depth: Jacobian,
    by_depth: float,
    is_depth: float,
    shares: tuple[float, float],
    moved: Array,
    moved_keyframe: Array,
) -> tuple[float, float]:
    """Derivatives of a residual by readout and delay.

    Args:
        J: Derivative of the residual by a motion of the point.
        J_depth: Derivative of the depth residual by it.
        by_depth: Derivative of the residual by the keyframe's depth, relative to that.
        is_depth: 1 for depth, 0 for brightness.
        shares: Times of the frame's and of the keyframe's row as shares of the readout.
        moved: (6,) twist of the keyframe's points while the frame was taken.
        moved_keyframe: (6,) twist while the keyframe was taken.
    """
    velocity, keyframe_velocity = _by_twist(J, moved), _by_twist(J, moved_keyframe)
    by_delay = is_depth * velocity + by_depth * _by_twist(J_depth, moved_keyframe)
    return shares[0] * velocity - shares[1] * keyframe_velocity, by_delay


@inline_kernel
def _magnify(
    position_m: Array, n: int, u: float, v: float, intrinsics: Array, T_camera_keyframe: Array
) -> tuple[float, float, float]:
    """Motion of point n in the keyframe's axes, m, by the logarithm of the focal length.

    It moves sideways in the frame's axes, where it is seen at (u, v), and in the keyframe's.
    """
    T, (x, y, z) = T_camera_keyframe, (position_m[0, n], position_m[1, n], position_m[2, n])
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
# Added to the diagonal of an information before it is inverted.
REGULARIZATION = 1e-3


@kernel
def given_focal(information: Array, state: Array) -> Array:
    """(2, 3) information of the timing, given focal length and disagreement of a state (4,)."""
    timing = np.empty((2, 3))
    for i in range(2):
        timing[i, 0], timing[i, 1] = information[i, 0], information[i, 1]
        timing[i, 2] = information[i, NUM_KEPT]
        for k in range(FOCAL, NUM_KEPT):
            timing[i, 2] -= information[i, k] * state[k]
    return timing


@kernel
def solve_information(information: Array) -> tuple[Array, Array]:
    """(N,) best state and its (N, N) covariance, of an information (N, N + 1)."""
    n = len(information)
    A = information[:, :n].copy()
    for k in range(n):
        A[k, k] += REGULARIZATION
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


@kernel
def estimate_calibration(known: Array, views: Array, error: float) -> tuple[Array, Array]:
    """(4,) state by all that is known, and its standard deviations.

    Args:
        known: (4, 5) information without that of the current keyframe's views.
        views: (4, 5) sum over those.
        error: Squared error of a view, relative to its information.
    """
    state, covariance = solve_information(known + limit_information(views, error))
    sigmas = np.empty(NUM_KEPT)
    for k in range(NUM_KEPT):
        sigmas[k] = np.sqrt(covariance[k, k])
    return state, sigmas


@kernel
def squared_error(view: Array, state: Array) -> float:
    """Mean squared error of a view's timing, relative to its information (4, 5); at least 1."""
    timing = given_focal(view, state)
    mean, _ = solve_information(timing)
    x, y = mean[0] - state[0], mean[1] - state[1]
    squared = timing[0, 0] * x * x + 2.0 * timing[0, 1] * x * y + timing[1, 1] * y * y
    return max(0.5 * float(squared), 1.0)
