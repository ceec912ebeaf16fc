"""Trajectories for tests of the metrics: random ones, and simple ones to check by hand."""

import numpy as np

from drivers.core.geometry import Array, Trajectory, rigid_transform, so3_exp
from vo_service.tools.evaluation.metrics import MatchedPoses


def poses_at(stamps_s: list[float]) -> Trajectory:
    """Make identity poses at these stamps."""
    return Trajectory(np.array(stamps_s), np.tile(np.eye(4), (len(stamps_s), 1, 1)))


def moving_along_x(x_m: list[float], turn_deg: list[float] | None = None) -> Array:
    """Make poses along the x axis, rotated about it."""
    turns_rad = np.radians(np.zeros(len(x_m)) if turn_deg is None else turn_deg)
    return np.array(
        [
            rigid_transform(so3_exp([angle, 0, 0]), [x, 0, 0])
            for x, angle in zip(x_m, turns_rad, strict=True)
        ]
    )


def match_poses(
    stamps_s: list[float], T_world_camera: Array, T_truth_camera: Array
) -> MatchedPoses:
    return MatchedPoses(np.array(stamps_s), T_world_camera, T_truth_camera)


def random_walk(rng: np.random.Generator, stamps_s: Array) -> Trajectory:
    """Make a random walk: 3 cm and 0.03 rad from one pose to the next."""
    T = rigid_transform(so3_exp(rng.normal(0, 1, 3)), rng.normal(0, 3, 3))
    poses = []
    for _ in stamps_s:
        step = rigid_transform(so3_exp(rng.normal(0, 0.03, 3)), rng.normal(0, 0.03, 3))
        T = T @ step
        poses.append(T)
    return Trajectory(stamps_s, np.array(poses))


def noisy_copy(
    rng: np.random.Generator, truth: Trajectory, stamps_s: Array, other_world: Array
) -> Trajectory:
    """Make an estimated trajectory at these stamps: the nearest true poses with 1 cm of noise."""
    nearest = np.abs(truth.stamps_s - stamps_s[:, None]).argmin(axis=1)
    noise = [
        rigid_transform(so3_exp(rng.normal(0, 0.01, 3)), rng.normal(0, 0.01, 3)) for _ in stamps_s
    ]
    return Trajectory(stamps_s, other_world @ truth.T_world_camera[nearest] @ np.array(noise))
