"""Error metrics of trajectories, as pure functions of matched poses.

ATE and RPE as Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012),
Section IV; the mean global error as Fontes and Maia, "Visual odometry for moving RGB-D cameras".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core import InputError
from drivers.core.geometry import (
    MAX_STAMP_DIFFERENCE_S,
    Array,
    Trajectory,
    fit_rigid_motion,
    has_match,
    inverse,
    nearest_indices,
    rotation_angle_rad,
    transform_points,
)

# Two stamps closer than this are the same stamp, rounded differently.
STAMP_ROUNDING_S = 0.001
MIN_MATCHES = 3


@dataclass(frozen=True)
class MatchedPoses:
    """M pairs of poses, in order of time; the two world frames may differ.

    Attributes:
        stamps_s: (M,) stamps of the trajectory's poses.
        T_world_camera: (M, 4, 4) poses of the trajectory, in its own world.
        T_truth_camera: (M, 4, 4) poses of the ground truth, in the truth's world.
    """

    stamps_s: Array
    T_world_camera: Array
    T_truth_camera: Array


def associate(
    trajectory: Trajectory, truth: Trajectory, max_difference_s: float = MAX_STAMP_DIFFERENCE_S
) -> MatchedPoses:
    """Pair each pose of the shorter list with the nearest of the other, if near in time.

    If both are equally long, the trajectory counts as the shorter one. This is the rule of evo's
    ``associate_trajectories``, so the results agree with evo's.

    Raises:
        InputError: Fewer than 3 poses have a match.
    """
    if len(trajectory) <= len(truth):
        own_indices = np.flatnonzero(
            has_match(trajectory.stamps_s, truth.stamps_s, max_difference_s)
        )
        truth_indices = nearest_indices(truth.stamps_s, trajectory.stamps_s[own_indices])
    else:
        truth_indices = np.flatnonzero(
            has_match(truth.stamps_s, trajectory.stamps_s, max_difference_s)
        )
        own_indices = nearest_indices(trajectory.stamps_s, truth.stamps_s[truth_indices])
    if len(own_indices) < MIN_MATCHES:
        raise InputError(
            _too_few_matches_message(len(own_indices), trajectory, truth, max_difference_s)
        )
    return MatchedPoses(
        trajectory.stamps_s[own_indices],
        trajectory.T_world_camera[own_indices],
        truth.T_world_camera[truth_indices],
    )


def coverage(
    poses_s: Array,
    truth_s: Array,
    frames_s: Array | None,
    max_difference_s: float = MAX_STAMP_DIFFERENCE_S,
) -> float | None:
    """Return the fraction of frames with ground truth that have a pose.

    A frame or pose has ground truth if a true pose lies within `max_difference_s`.

    Args:
        frames_s: (F,) stamps of all frames of the recording; None if not known. A truth with a
            pose at the stamp of every pose then counts as one true pose per frame. Other truths
            (motion capture at 100 Hz) do not show how many frames there were.

    Returns:
        0 to 1; None if the number of frames is not known.
    """
    if frames_s is None:
        has_truth_per_frame = bool(np.all(has_match(poses_s, truth_s, STAMP_ROUNDING_S)))
        frames_s = truth_s if has_truth_per_frame else np.empty(0)
    frames = np.count_nonzero(has_match(frames_s, truth_s, max_difference_s))
    poses = np.count_nonzero(has_match(poses_s, truth_s, max_difference_s))
    return min(1.0, float(poses / frames)) if frames else None


def _too_few_matches_message(
    matches: int, trajectory: Trajectory, truth: Trajectory, max_difference_s: float
) -> str:
    nearest_s = truth.stamps_s[nearest_indices(truth.stamps_s, trajectory.stamps_s)]
    differences_s = np.abs(nearest_s - trajectory.stamps_s)
    closest = f"; the two closest are {differences_s.min():.3f} s apart" if len(nearest_s) else ""
    return (
        f"{matches} of {len(trajectory)} poses have ground truth within "
        f"{1000 * max_difference_s:.6g} ms, {MIN_MATCHES} are needed "
        f"(trajectory {_format_span(trajectory)}, truth {_format_span(truth)}{closest}); "
        "use the truth of the same recording, on the same clock"
    )


def _format_span(poses: Trajectory) -> str:
    return f"{poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s" if len(poses) else "empty"


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


def tracked_steps(matched: MatchedPoses, stamps_s: Array, epochs: NDArray[np.int64]) -> PosePairs:
    """Pair each matched pose with the next pose of its trajectory, where both have truth.

    Frames without a pose in between do not matter: the next pose continues from the last one.
    Steps into another epoch are left out: there the odometry reports a discontinuity.

    Args:
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
