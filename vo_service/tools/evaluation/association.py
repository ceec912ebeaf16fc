"""Association of a trajectory's poses with the ground truth by their stamps."""

from dataclasses import dataclass

import numpy as np

from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.core.trajectory import MAX_STAMP_DIFFERENCE_S, Trajectory, has_match, nearest_indices

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


def associate(trajectory: Trajectory, truth: Trajectory) -> MatchedPoses:
    """Pair each pose of the shorter list with the nearest of the other, at most 20 ms apart.

    If both are equally long, the trajectory counts as the shorter one. This is the rule of evo's
    ``associate_trajectories``, so the results agree with evo's.

    Raises:
        InputError: Fewer than 3 poses have a match.
    """
    if len(trajectory) <= len(truth):
        own_indices = np.flatnonzero(has_match(trajectory.stamps_s, truth.stamps_s))
        truth_indices = nearest_indices(truth.stamps_s, trajectory.stamps_s[own_indices])
    else:
        truth_indices = np.flatnonzero(has_match(truth.stamps_s, trajectory.stamps_s))
        own_indices = nearest_indices(trajectory.stamps_s, truth.stamps_s[truth_indices])
    if len(own_indices) < MIN_MATCHES:
        raise InputError(_too_few_matches_message(len(own_indices), trajectory, truth))
    return MatchedPoses(
        trajectory.stamps_s[own_indices],
        trajectory.T_world_camera[own_indices],
        truth.T_world_camera[truth_indices],
    )


def coverage(poses_s: Array, truth_s: Array, frames_s: Array | None) -> float | None:
    """Return the fraction of frames with ground truth that have a pose.

    A frame or pose has ground truth if a true pose lies within 20 ms.

    Args:
        poses_s: (N,) stamps of the poses.
        truth_s: (T,) stamps of the ground truth.
        frames_s: (F,) stamps of all frames of the recording; None if not known. A truth with a
            pose at the stamp of every pose then counts as one true pose per frame. Other truths
            (motion capture at 100 Hz) do not show how many frames there were.

    Returns:
        0 to 1; None if the number of frames is not known.
    """
    if frames_s is None:
        has_truth_per_frame = bool(np.all(has_match(poses_s, truth_s, STAMP_ROUNDING_S)))
        frames_s = truth_s if has_truth_per_frame else np.empty(0)
    frames = np.count_nonzero(has_match(frames_s, truth_s))
    poses = np.count_nonzero(has_match(poses_s, truth_s))
    return min(1.0, float(poses / frames)) if frames else None


def _too_few_matches_message(matches: int, trajectory: Trajectory, truth: Trajectory) -> str:
    return (
        f"{matches} of {len(trajectory)} poses have ground truth within "
        f"{1000 * MAX_STAMP_DIFFERENCE_S:.0f} ms, {MIN_MATCHES} are needed "
        f"(trajectory {_format_span(trajectory)}, truth {_format_span(truth)}); "
        "use the truth of the same recording, on the same clock"
    )


def _format_span(poses: Trajectory) -> str:
    return f"{poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s" if len(poses) else "empty"
