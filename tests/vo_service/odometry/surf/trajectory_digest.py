"""Prints a digest of a small trajectory: run with other thread counts, it must be the same."""

import hashlib
import sys

import cv2

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.surf.odometry import SurfOdometry


def trajectory_digest() -> str:
    """Digest of poses and covariances."""
    odometry = SurfOdometry()
    digest = hashlib.sha256()
    for seq in range(4):
        T = rigid_transform(so3_exp([0.0, 0.01 * seq, 0.004 * seq]), [0.01 * seq] * 3)
        estimate = odometry.estimate(render_corner(T, seq))
        digest.update(estimate.T_world_camera.tobytes() + estimate.covariance.tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    cv2.setNumThreads(int(sys.argv[1]))
    print(trajectory_digest())
