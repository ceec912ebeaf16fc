"""Error metrics of trajectories, as pure functions of matched poses.

ATE and RPE as Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012),
Section IV; the mean global error as Fontes and Maia, "Visual odometry for moving RGB-D cameras".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, rotation_angle_rad, transform_points
from drivers.core.trajectory import nearest_indices
from vo_service.odometry.rigid_motion import fit_rigid_motion
from vo_service.tools.evaluation.association import MatchedPoses

Indices = NDArray[np.intp]

# Recordings with a low frame rate have no pose exactly one second later.
ONE_SECOND_TOLERANCE_S = 0.1
# The last pose may be this much early for a full second, because stamps are rounded.
END_TOLERANCE_S = 0.001


@dataclass(frozen=True)
class PosePairs:
    """Pairs of matched poses for relative errors: indices of the earlier and the later pose."""

    earlier: Indices
    later: Indices

    def __len__(self) -> int:
        return len(self.earlier)


@dataclass(frozen=True)
class RelativeErrors:
    """Relative pose errors of K pairs: (K,) meters and (K,) degrees."""

    translation_m: Array
    rotation_deg: Array


def best_alignment(matched: MatchedPoses) -> Array:
    """Return the T_truth_world that best aligns the positions, without scale (Horn, Umeyama)."""
    positions_m = matched.T_world_camera[:, :3, 3]
    weights = np.ones(len(positions_m))
    return fit_rigid_motion(positions_m, matched.T_truth_camera[:, :3, 3], weights)


def first_pose_alignment(matched: MatchedPoses) -> Array:
    """Return the T_truth_world that aligns the first matched poses, position and rotation."""
    T_truth_world: Array = matched.T_truth_camera[0] @ inverse(matched.T_world_camera[0])
    return T_truth_world


def position_errors_m(matched: MatchedPoses, T_truth_world: Array) -> Array:
    """Return the distance (M,) of each aligned pose from its truth."""
    aligned_m = transform_points(T_truth_world, matched.T_world_camera[:, :3, 3])
    return np.asarray(np.linalg.norm(aligned_m - matched.T_truth_camera[:, :3, 3], axis=1))


def consecutive_pairs(matched: MatchedPoses) -> PosePairs:
    """Pair each matched pose with the next one, also across a gap (evo's delta of one frame)."""
    indices = np.arange(len(matched.stamps_s))
    return PosePairs(indices[:-1], indices[1:])


def pairs_one_second_apart(matched: MatchedPoses) -> PosePairs:
    """Pair each matched pose i with the one nearest to t_i + 1 s (``--fixed_delta`` of TUM's tool).

    The later pose must be within 0.1 s of that time (the TUM tool takes any), and the trajectory
    must last that long. A pair of a full second that ends at the last pose is kept (the TUM tool
    drops it).
    """
    target_s = matched.stamps_s + 1.0
    nearest = nearest_indices(matched.stamps_s, target_s)
    is_second = np.abs(matched.stamps_s[nearest] - target_s) <= ONE_SECOND_TOLERANCE_S
    earlier = np.flatnonzero(is_second & (target_s <= matched.stamps_s[-1] + END_TOLERANCE_S))
    return PosePairs(earlier, nearest[earlier])


def relative_errors(matched: MatchedPoses, pairs: PosePairs) -> RelativeErrors:
    """Return E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) of each pair: Q truth, P trajectory (eq. 1)."""
    true_motion = _relative_poses(matched.T_truth_camera, pairs)
    motion = _relative_poses(matched.T_world_camera, pairs)
    E = np.linalg.solve(true_motion, motion)
    angles_rad = np.array([rotation_angle_rad(T[:3, :3]) for T in E])
    return RelativeErrors(np.linalg.norm(E[:, :3, 3], axis=1), np.degrees(angles_rad))


def rms(errors: Array) -> float | None:
    """Return the root mean square, or None without an error."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else None


def _relative_poses(T_world_camera: Array, pairs: PosePairs) -> Array:
    """Return T_earlier_later (K, 4, 4) of each pair."""
    earlier, later = T_world_camera[pairs.earlier], T_world_camera[pairs.later]
    return np.asarray(np.linalg.solve(earlier, later), np.float64)
