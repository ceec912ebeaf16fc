"""The rigid motion between two sets of points, by singular value decomposition.

Sorkine-Hornung and Rabinovich, "Least-Squares Rigid Motion Using SVD" (2017): the five steps of
its Section 4. Points are rows.
"""

import numpy as np

from drivers.core.geometry import Array, rigid_transform


def fit_rigid_motion(P: Array, Q: Array, w: Array) -> Array:
    """4x4 transform T that minimizes sum w_i |T p_i - q_i|^2; 3 points or more, not on a line.

    Args:
        P: (N, 3) points p_i.
        Q: (N, 3) points q_i.
        w: (N,) weights.
    """
    # Step 1: the weighted centroids.
    p_mean, q_mean = w @ P / w.sum(), w @ Q / w.sum()
    # Step 2: the centered vectors.
    X, Y = P - p_mean, Q - q_mean
    # Step 3: the 3x3 covariance matrix S = X W Y^T, with points as columns.
    S = (X * w[:, None]).T @ Y
    # Step 4: with S = U D V^T, R = V diag(1, 1, det(V U^T)) U^T, which is no reflection.
    U, _, Vt = np.linalg.svd(S)
    V = Vt.T
    sign = 1.0 if np.linalg.det(V @ U.T) >= 0 else -1.0
    R = V @ np.diag([1.0, 1.0, sign]) @ U.T
    # Step 5: the translation.
    return rigid_transform(R, q_mean - R @ p_mean)


def motion_covariance(P: Array, w: Array, sigma_m: Array) -> Array:
    """6x6 covariance of a fitted motion, (translation m, rotation rad) in the axes of P.

    First order: the fit solves H xi = sum w_i J_i^T r_i with H = sum w_i J_i^T J_i, so
    cov(xi) = H^-1 M H^-1 with M = sum w_i^2 J_i^T diag(sigma_i^2) J_i.
    An unconstrained direction (all points on a line) gets a meter and a radian, not infinity.

    Args:
        P: (N, 3) as given to the fit.
        w: (N,) as given to the fit.
        sigma_m: (N, 3) standard deviations of T p_i - q_i in the axes of P.
    """
    J = _motion_jacobian(P)
    weighted = (J * np.sqrt(w)[:, None, None]).reshape(-1, 6)
    noise = (J * (w[:, None] * sigma_m)[:, :, None]).reshape(-1, 6)
    H_inverse = np.linalg.inv(weighted.T @ weighted + np.eye(6))
    covariance: Array = H_inverse @ (noise.T @ noise + np.eye(6)) @ H_inverse
    return 0.5 * (covariance + covariance.T)


def _motion_jacobian(P: Array) -> Array:
    """(N, 3, 6) Jacobian of a point by a small motion (rho, phi): rho + phi x p."""
    x, y, z = P.T
    J = np.zeros((len(P), 3, 6))
    J[:, :, :3] = np.eye(3)
    J[:, 0, 4], J[:, 0, 5] = z, -y
    J[:, 1, 3], J[:, 1, 5] = -z, x
    J[:, 2, 3], J[:, 2, 4] = y, -x
    return J
