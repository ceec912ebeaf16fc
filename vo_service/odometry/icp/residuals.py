"""Residuals between a frame's surfaces and the planes of a reference, and their normal equations.

A plane's point is projected into the frame, and the reading there is compared with the depth of the
moved plane (projective association, Blais and Levine 1995). The difference in 1/z is the distance
from the plane (Chen and Medioni 1991), divided by the plane's distance from the camera and by the
point's depth. In this unit the sensor's noise is the same everywhere.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel

# Readings around a projected point that differ by more (1/m) lie on an edge.
MAX_STEP_PER_M = 0.04
# Smallest cosine of the angle between normal and ray at the new pose.
MIN_COSINE = 0.1
MIN_DEPTH_M = 0.05
# What a plane's point projects to.
NO_READING, EDGE, SURFACE = 0, 1, 2
# Degrees of freedom of Student's t, the model of the residuals: many are outliers.
DEGREES_OF_FREEDOM = 5.0


@inline_kernel
def robust_cost(normalized_residual: float) -> float:
    """Cost by Student's t of a residual divided by sigma."""
    return float(np.log(1.0 + normalized_residual * normalized_residual / DEGREES_OF_FREEDOM))


@kernel
def accumulate_normal_equations(
    planes: Array,
    T_camera_reference: Array,
    inverse_depth: NDArray[np.float32],
    intrinsics: Array,
    normal_noise: float,
    sigma: float,
    gate: float,
) -> tuple[Array, Array, Array, Array]:
    """Accumulate the normal equations of one step: information, vector, moments and counts.

    With r = J xi, xi = (translation, rotation) of the reference's points in its own axes, the
    information (6, 6) is sum w J^T J and the vector (6,) is sum w J^T r. The moments (4, 4) are
    sum w v^2 q q^T, with q the point (x, y, z, 1) and v^2 the variance of J's direction by the
    normal's noise: its standard deviation is normal_noise (rad/m) times the plane's distance.

    The counts (5,) are: planes with a reading; of these, planes within the gate (1/m), and planes
    within three sigma; sum w r^2; and the robust cost of all planes with a reading, where those
    beyond the gate cost as much as at the gate.

    Args:
        planes: (N, 7) of the reference.
        T_camera_reference: 4x4 motion.
        inverse_depth: (H, W) of the frame, 1/m; 0 = no reading.
        intrinsics: (4,) of the frame.
        normal_noise: See above.
        sigma: Expected sigma of the residuals, 1/m.
        gate: Largest residual that is used, 1/m.
    """
    H, g, moments, counts = np.zeros((6, 6)), np.zeros(6), np.zeros((4, 4)), np.zeros(5)
    J = np.empty(6)
    q = np.ones(4)
    s = _translation_in_reference(T_camera_reference)
    max_cost = robust_cost(gate / sigma)
    for n in range(len(planes)):
        kind, r, scale = _residual(planes[n], T_camera_reference, s, inverse_depth, intrinsics)
        if kind == NO_READING:
            continue
        counts[0] += 1.0
        if kind == EDGE or abs(r) > gate:
            counts[4] += max_cost
            continue
        squared = r * r / (sigma * sigma)
        w = (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
        counts[1] += 1.0
        counts[2] += squared <= 9.0
        counts[3] += w * r * r
        counts[4] += robust_cost(r / sigma)
        _jacobian(planes[n], scale, J)
        for i in range(6):
            weighted = w * J[i]
            g[i] += weighted * r
            for j in range(i, 6):
                H[i, j] += weighted * J[j]
        q[:3] = planes[n, :3]
        variance = w * (scale * normal_noise * planes[n, 6]) ** 2
        for i in range(4):
            for j in range(i, 4):
                moments[i, j] += variance * q[i] * q[j]
    _copy_upper_to_lower(H)
    _copy_upper_to_lower(moments)
    return H, g, moments, counts


@kernel
def compute_residuals(
    planes: Array,
    T_camera_reference: Array,
    inverse_depth: NDArray[np.float32],
    intrinsics: Array,
) -> Array:
    """(N, 3): the pixel u, v that each plane's point projects to, and the residual there, 1/m.

    The pixel is NaN outside of the image. The residual is NaN without a reading and infinite on an
    edge.

    Args:
        planes: (N, 7) of the reference.
        T_camera_reference: 4x4 motion.
        inverse_depth: (H, W) of the frame, 1/m; 0 = no reading.
        intrinsics: (4,) of the frame.
    """
    residuals = np.full((len(planes), 3), np.nan)
    s = _translation_in_reference(T_camera_reference)
    height, width = inverse_depth.shape
    for n in range(len(planes)):
        x, y, z = _transform_point(planes[n], T_camera_reference)
        u, v = intrinsics[0] * x / z + intrinsics[2], intrinsics[1] * y / z + intrinsics[3]
        if z < MIN_DEPTH_M or not (0.0 <= u <= width - 1 and 0.0 <= v <= height - 1):
            continue
        residuals[n, 0], residuals[n, 1] = u, v
        kind, r, _ = _residual(planes[n], T_camera_reference, s, inverse_depth, intrinsics)
        if kind == SURFACE:
            residuals[n, 2] = r
        elif kind == EDGE:
            residuals[n, 2] = np.inf
    return residuals


@inline_kernel
def _copy_upper_to_lower(A: Array) -> None:
    for i in range(len(A)):
        for j in range(i):
            A[i, j] = A[j, i]


@inline_kernel
def _translation_in_reference(T: Array) -> Array:
    s = np.empty(3)
    for i in range(3):
        s[i] = T[0, i] * T[0, 3] + T[1, i] * T[1, 3] + T[2, i] * T[2, 3]
    return s


@inline_kernel
def _transform_point(plane: Array, T: Array) -> tuple[float, float, float]:
    px, py, pz = plane[0], plane[1], plane[2]
    return (
        T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3],
        T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3],
        T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3],
    )


@inline_kernel
def _residual(
    plane: Array,
    T_camera_reference: Array,
    s: Array,
    inverse_depth: NDArray[np.float32],
    intrinsics: Array,
) -> tuple[int, float, float]:
    """Kind of the reading at a plane's point, the residual (1/m), and its scale (1/m per meter).

    s is the translation (3,) in the reference's axes: n . s is the change of the plane's distance.
    """
    x, y, z = _transform_point(plane, T_camera_reference)
    distance = plane[6] + plane[3] * s[0] + plane[4] * s[1] + plane[5] * s[2]
    if z < MIN_DEPTH_M or distance < MIN_COSINE * np.sqrt(x * x + y * y + z * z):
        return NO_READING, 0.0, 0.0
    u = intrinsics[0] * x / z + intrinsics[2]
    v = intrinsics[1] * y / z + intrinsics[3]
    kind, w = _interpolate_inverse_depth(inverse_depth, u, v)
    return kind, w - 1.0 / z, 1.0 / (distance * z)


@inline_kernel
def _interpolate_inverse_depth(
    inverse_depth: NDArray[np.float32], u: float, v: float
) -> tuple[int, float]:
    """Kind of the four pixels at a position, and the bilinear 1/z of a surface."""
    height, width = inverse_depth.shape
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return NO_READING, 0.0
    column, row = int(u), int(v)
    a, b = inverse_depth[row, column], inverse_depth[row, column + 1]
    c, d = inverse_depth[row + 1, column], inverse_depth[row + 1, column + 1]
    lowest = min(min(a, b), min(c, d))
    if lowest <= 0.0:
        return NO_READING, 0.0
    if max(max(a, b), max(c, d)) - lowest > MAX_STEP_PER_M:
        return EDGE, 0.0
    right, down = u - column, v - row
    above, below = a + right * (b - a), c + right * (d - c)
    return SURFACE, float(above + down * (below - above))


@inline_kernel
def _jacobian(plane: Array, scale: float, J: Array) -> None:
    """Fill J (6,): scale times (n, p x n)."""
    px, py, pz, nx, ny, nz = plane[0], plane[1], plane[2], plane[3], plane[4], plane[5]
    J[0], J[1], J[2] = scale * nx, scale * ny, scale * nz
    J[3], J[4], J[5] = (
        scale * (py * nz - pz * ny),
        scale * (pz * nx - px * nz),
        scale * (px * ny - py * nx),
    )
