"""Which pose of a trajectory belongs to which pose of the ground truth, by their stamps."""

from dataclasses import dataclass

import numpy as np

from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.core.trajectory import MAX_STAMP_DIFFERENCE_S, Trajectory, has_match, nearest_indices

# Closer than this, two stamps are one stamp written with different rounding.
STAMP_ROUNDING_S = 0.001
MIN_MATCHES = 3


@dataclass(frozen=True)
class MatchedPoses:
    """M pairs of poses, in order of time; the two worlds need not agree.

    stamps_s        (M,) of the trajectory's poses
    T_world_camera  (M, 4, 4) the trajectory's, in its own world
    T_truth_camera  (M, 4, 4) the ground truth's, in the truth's world
    """

    stamps_s: Array
    T_world_camera: Array
    T_truth_camera: Array


def associate(trajectory: Trajectory, truth: Trajectory) -> MatchedPoses:
    """Pair each pose of the shorter list with the nearest of the other, at most 20 ms apart.

    The trajectory counts as the shorter one where both are as long. This is the rule of evo's
    ``associate_trajectories``, so the figures agree with evo's.

    Raises InputError if fewer than 3 poses find a partner.
    """
    if len(trajectory) <= len(truth):
        mine = np.flatnonzero(has_match(trajectory.stamps_s, truth.stamps_s))
        theirs = nearest_indices(truth.stamps_s, trajectory.stamps_s[mine])
    else:
        theirs = np.flatnonzero(has_match(truth.stamps_s, trajectory.stamps_s))
        mine = nearest_indices(trajectory.stamps_s, truth.stamps_s[theirs])
    if len(mine) < MIN_MATCHES:
        raise InputError(_too_few_matches_message(len(mine), trajectory, truth))
    return MatchedPoses(
        trajectory.stamps_s[mine], trajectory.T_world_camera[mine], truth.T_world_camera[theirs]
    )


def coverage(poses_s: Array, truth_s: Array, frames_s: Array | None) -> float | None:
    """Poses that have ground truth within 20 ms, as a share of the frames that have it.

    frames_s  stamps of all frames that the recording delivered; None if they are not known. A
              truth that has a pose at the very stamp of every pose is then taken to have one a
              frame. Any other (motion capture at 100 Hz) does not say how many frames there were.

    Returns None where it cannot be told.
    """
    if frames_s is None:
        one_a_frame = bool(np.all(has_match(poses_s, truth_s, STAMP_ROUNDING_S)))
        frames_s = truth_s if one_a_frame else np.empty(0)
    frames = np.count_nonzero(has_match(frames_s, truth_s))
    poses = np.count_nonzero(has_match(poses_s, truth_s))
    return min(1.0, float(poses / frames)) if frames else None


def _too_few_matches_message(matches: int, trajectory: Trajectory, truth: Trajectory) -> str:
    mine, theirs = map(_format_span, (trajectory, truth))
    return (
        f"{matches} of {len(trajectory)} poses have ground truth within {1000 * MAX_STAMP_DIFFERENCE_S:.0f} ms, "
        f"{MIN_MATCHES} are needed (trajectory {mine}, truth {theirs}): "
        "give the truth of the same recording, on the same clock"
    )


def _format_span(poses: Trajectory) -> str:
    return f"{poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s" if len(poses) else "empty"
