"""The figures that trajectories are compared by, as pure functions of matched poses.

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

# A pose counts as one second later if it is so to a tenth: recordings of a low frame rate have
# none that is exact.
ONE_SECOND_TOLERANCE_S = 0.1
# How far the last pose may fall short of a full second: rounding of stamps.
END_TOLERANCE_S = 0.001


@dataclass(frozen=True)
class PosePairs:
    """Pairs of matched poses that a relative error is taken over: indices, earlier and later."""

    earlier: Indices
    later: Indices

    def __len__(self) -> int:
        return len(self.earlier)


@dataclass(frozen=True)
class RelativeErrors:
    """Relative pose errors, one a pair: (K,) metres and (K,) degrees."""

    translation_m: Array
    rotation_deg: Array


def best_alignment(matched: MatchedPoses) -> Array:
    """T_truth_world that brings the positions nearest to the truth's; no scale (Horn, Umeyama)."""
    positions_m = matched.T_world_camera[:, :3, 3]
    weights = np.ones(len(positions_m))
    return fit_rigid_motion(positions_m, matched.T_truth_camera[:, :3, 3], weights)


def first_pose_alignment(matched: MatchedPoses) -> Array:
    """T_truth_world that joins the first matched poses, position and direction."""
    T_truth_world: Array = matched.T_truth_camera[0] @ inverse(matched.T_world_camera[0])
    return T_truth_world


def position_errors_m(matched: MatchedPoses, T_truth_world: Array) -> Array:
    """(M,) distance of each aligned pose from its truth."""
    aligned_m = transform_points(T_truth_world, matched.T_world_camera[:, :3, 3])
    return np.asarray(np.linalg.norm(aligned_m - matched.T_truth_camera[:, :3, 3], axis=1))


def consecutive_pairs(matched: MatchedPoses) -> PosePairs:
    """Each matched pose with the next one, also across a gap (evo's delta of one frame)."""
    indices = np.arange(len(matched.stamps_s))
    return PosePairs(indices[:-1], indices[1:])


def pairs_one_second_apart(matched: MatchedPoses) -> PosePairs:
    """Each matched pose i with the one nearest to t_i + 1 s, as the TUM tool's ``--fixed_delta``.

    Only where the one found is one second later to within 0.1 s (the TUM tool takes any), and
    where the trajectory goes on for that second (the TUM tool leaves out every pair that ends at
    the last pose; here one that is a full second long is kept).
    """
    wanted_s = matched.stamps_s + 1.0
    found = nearest_indices(matched.stamps_s, wanted_s)
    is_second = np.abs(matched.stamps_s[found] - wanted_s) <= ONE_SECOND_TOLERANCE_S
    earlier = np.flatnonzero(is_second & (wanted_s <= matched.stamps_s[-1] + END_TOLERANCE_S))
    return PosePairs(earlier, found[earlier])


def relative_errors(matched: MatchedPoses, pairs: PosePairs) -> RelativeErrors:
    """E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) of each pair, Q the truth and P the trajectory (eq. 1)."""
    true_motion = _relative_poses(matched.T_truth_camera, pairs)
    motion = _relative_poses(matched.T_world_camera, pairs)
    E = np.linalg.solve(true_motion, motion)
    angles_rad = np.array([rotation_angle_rad(T[:3, :3]) for T in E])
    return RelativeErrors(np.linalg.norm(E[:, :3, 3], axis=1), np.degrees(angles_rad))


def rms(errors: Array) -> float | None:
    """Root mean square; None of no errors at all."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else None


def _relative_poses(T_world_camera: Array, pairs: PosePairs) -> Array:
    """(K, 4, 4) T_earlier_later of each pair."""
    earlier, later = T_world_camera[pairs.earlier], T_world_camera[pairs.later]
    return np.asarray(np.linalg.solve(earlier, later), np.float64)
