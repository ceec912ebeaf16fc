"""Normal equations of the color camera's focal length.

A wrong focal length magnifies the keyframe's points and the frame alike, so that it leaves
residuals as soon as the points have moved in the image. One more column of the normal equations
measures it; pose and brightness are marginalized, as they are estimated with it. Brightness and
depth have equations of their own: if they do not agree, the camera is not well calibrated.
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.gauss_newton import fill_jacobian, solve_cholesky
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
)
from vo_service.odometry.direct.parameters import FOCAL_POINT_STRIDE
from vo_service.odometry.direct.residuals import (
    GAIN,
    OFFSET,
    WEIGHT_BRIGHTNESS,
    residual_variances,
    student_curvature,
    student_weight,
)
from vo_service.odometry.direct.warping import (
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_U,
    SAMPLE_V,
)

# Pose (6), gain, offset, focal length.
_NUM_UNKNOWNS = 9
_FOCAL = 8
# Rows of the information about the focal length.
BY_BRIGHTNESS, BY_DEPTH = 0, 1
# Keeps the marginalization finite where a view does not constrain the pose, relative to its scale.
_DAMPING_RATIO = 1e-6


@kernel
def measure_focal_length(
    points: Array,
    samples: Array,
    cell_weights: Array,
    residual_model: Array,
    intrinsics: Array,
    T_camera_keyframe: Array,
) -> Array:
    """Information about the focal length of one view, by brightness and by depth.

    Args:
        points: (N, COLUMNS) of the keyframe's finest level.
        samples: (N, COLUMNS) of the view.
        cell_weights: (2, CELLS).
        residual_model: (5,), see `residuals`.
        intrinsics: (4,) of the whole image.
        T_camera_keyframe: 4x4.

    Returns:
        (2, 2), for each the information A and the product A x with the best change x of the
        logarithm of the focal length.
    """
    H, g = np.zeros((2, _NUM_UNKNOWNS, _NUM_UNKNOWNS)), np.zeros((2, _NUM_UNKNOWNS))
    row = np.zeros(_NUM_UNKNOWNS)
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = residual_variances(residual_model)
    fx, fy, cx, cy = intrinsics
    T = T_camera_keyframe
    for i in range(0, len(points), FOCAL_POINT_STRIDE):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        point, cell = points[i], int(samples[i, SAMPLE_CELL])
        x, y, z = point[0], point[1], point[2]
        # The point moves sideways in the frame's axes, and in the keyframe's by as much.
        z_there = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        x_there = (samples[i, SAMPLE_U] - cx) / fx * z_there
        y_there = (samples[i, SAMPLE_V] - cy) / fy * z_there
        dx = T[0, 0] * x_there + T[1, 0] * y_there - x
        dy = T[0, 1] * x_there + T[1, 1] * y_there - y
        dz = T[0, 2] * x_there + T[1, 2] * y_there
        if point[HAS_TEXTURE] > 0:
            residual = brightness - gain * point[POINT_BRIGHTNESS] - offset
            sample_variance = variance + point[POINT_BRIGHTNESS_VARIANCE]
            w = student_weight(residual, sample_variance)
            w *= residual_model[WEIGHT_BRIGHTNESS] * cell_weights[0, cell]
            fill_jacobian(point, POINT_BRIGHTNESS_GRADIENT, gain, row)
            row[6], row[7] = -point[POINT_BRIGHTNESS], -1.0
            row[_FOCAL] = row[0] * dx + row[1] * dy + row[2] * dz
            curvature = w * student_curvature(residual, sample_variance)
            _add_row(H[BY_BRIGHTNESS], g[BY_BRIGHTNESS], row, curvature, w * residual)
        if not np.isnan(depth) and point[HAS_SHAPE] > 0:
            w = student_weight(depth, variance_depth) * cell_weights[1, cell]
            fill_jacobian(point, POINT_DEPTH_GRADIENT, 1.0, row)
            row[6] = row[7] = 0.0
            row[_FOCAL] = row[0] * dx + row[1] * dy + row[2] * dz
            curvature = w * student_curvature(depth, variance_depth)
            _add_row(H[BY_DEPTH], g[BY_DEPTH], row, curvature, w * depth)
    information = np.empty((2, 2))
    for k in range(2):
        information[k, 0], information[k, 1] = _marginalize(H[k], g[k])
    return information


@inline_kernel
def _add_row(H: Array, g: Array, row: Array, weight: float, weighted_residual: float) -> None:
    for a in range(_NUM_UNKNOWNS):
        weighted = weight * row[a]
        for b in range(a, _NUM_UNKNOWNS):
            H[a, b] += weighted * row[b]
        g[a] += row[a] * weighted_residual


@kernel
def _marginalize(H: Array, g: Array) -> tuple[float, float]:
    """Information A of the focal length and A x; of H (9, 9) the upper triangle is used."""
    n = _FOCAL
    scale = np.empty(n)
    X, y, z = np.empty((n, n)), np.empty(n), np.empty(n)
    for a in range(n):
        scale[a] = 1.0 / np.sqrt(H[a, a] + 1e-12)
    for a in range(n):
        for b in range(a, n):
            X[a, b] = X[b, a] = H[a, b] * scale[a] * scale[b]
        X[a, a] += _DAMPING_RATIO
        y[a], z[a] = H[a, n] * scale[a], g[a] * scale[a]
    solved = solve_cholesky(X, y)
    A, b_value = H[n, n], -g[n]
    for a in range(n):
        A -= y[a] * solved[a]
        b_value += z[a] * solved[a]
    return max(A, 0.0), b_value
