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
# A step has a gross error if it exceeds one of these limits.
GROSS_ERROR_M = 0.05
GROSS_ERROR_DEG = 3.0


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


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of M matched poses.

    Attributes:
        stamps_s: (M,) stamps of the poses.
        global_error_m: (M,) distance from the truth after alignment of the first matched poses.
        step_errors: (M - 1,) error of each motion from one pose to the next.
    """

    stamps_s: Array
    global_error_m: Array
    step_errors: RelativeErrors


def error_series(matched: MatchedPoses) -> ErrorSeries:
    """Return the errors behind the mean global error (mean) and the RPE of one frame (RMS)."""
    return ErrorSeries(
        matched.stamps_s,
        position_errors_m(matched, first_pose_alignment(matched)),
        relative_errors(matched, consecutive_pairs(matched)),
    )


def tracked_steps(matched: MatchedPoses, stamps_s: Array, epochs: NDArray[np.int64]) -> PosePairs:
    """Pair each matched pose with the next pose of its trajectory, where both have truth.

    Frames without a pose in between do not matter: the next pose continues from the last one.
    Steps into another epoch are left out: there the odometry reports a discontinuity.

    Args:
        matched: Matched poses of a trajectory.
        stamps_s: (N,) stamps of all poses of this trajectory.
        epochs: (N,) their epochs.
    """
    order = np.searchsorted(stamps_s, matched.stamps_s)
    is_next = (np.diff(order) == 1) & (np.diff(epochs[order]) == 0)
    earlier = np.flatnonzero(is_next)
    return PosePairs(earlier, earlier + 1)


def count_gross_errors(matched: MatchedPoses, steps: PosePairs) -> int:
    """Count the steps with an error of more than 5 cm or 3 degrees."""
    errors = relative_errors(matched, steps)
    is_gross = (errors.translation_m > GROSS_ERROR_M) | (errors.rotation_deg > GROSS_ERROR_DEG)
    return int(np.count_nonzero(is_gross))
