"""Consistency of a method's covariance: its errors compared with the covariance it reports.

Each FOLDER is a TUM folder with an exact ground truth. --rooms renders five seconds for each seed
and stores them in FOLDER; room, motion and sensor timing differ. "since" is the motion since the
reference (for `direct` the keyframe). "step" is the motion since the previous frame, with the
covariance that the service publishes for it. "mean" is the normalized squared error (NEES) per
degree of freedom: 1 is consistent, more is overconfident. "in 95 %" is how often the 95 % ellipsoid
contains the truth.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.harness import Table, option
from benchmarks.rendered_sequences import render_all
from benchmarks.tracking import METHOD, open_frames_with_truth, track
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, inverse, nearest_indices, so3_log
from drivers.synthetic.config import MotionKind, ShutterTiming, SyntheticConfig
from vo_service.odometry.uncertainty import CovarianceAccumulator
from vo_service.tools.evaluation.metrics import STAMP_ROUNDING_S
from vo_service.types.estimate import Estimate

DEGREES_OF_FREEDOM = 6
CHI2_95_PERCENT = chi2.ppf(0.95, DEGREES_OF_FREEDOM)
SEEDS = tuple(range(101, 113))
DURATION_S = 5.0
MOTIONS = (MotionKind.HAND_HELD, MotionKind.ORBIT, MotionKind.FLOOR, MotionKind.SMOOTH)
TIMINGS = {
    "ideal": ShutterTiming(0.0, 0.0),
    "rolling-10": ShutterTiming(0.020, 0.010),
    "rolling--12": ShutterTiming(0.020, -0.012),
}
TABLE = Table(
    *(42, "motions:8d", "since: mean:13.2f", "in 95 %:9.1f", "step: mean:12.2f", "in 95 %:9.1f")
)


def make_configs(seeds: Sequence[int]) -> dict[str, SyntheticConfig]:
    """Configurations by name; each seed has its own room, motion and sensor timing."""
    kinds = list(TIMINGS)
    configs = {}
    for number, seed in enumerate(seeds):
        motion, kind = MOTIONS[number % len(MOTIONS)], kinds[number % len(kinds)]
        configs[f"{motion}-room{seed}-{kind}"] = SyntheticConfig(
            seed=seed, duration_s=DURATION_S, motion=motion, timing=TIMINGS[kind]
        )
    return configs


def nees(T_true: Array, T_estimated: Array, covariance: Array) -> float:
    """Return the NEES x^T C^-1 x of the error x (6,) of a motion 4x4, in its end frame."""
    T_error = inverse(T_true) @ T_estimated
    error = np.concatenate([T_error[:3, 3], so3_log(T_error[:3, :3])])
    return float(error @ np.linalg.solve(covariance, error))


def normalized_errors(estimates: Sequence[Estimate], T_truth: Array) -> Array:
    """NEES (N, 2) of the motions since the reference, and of those since the previous frame.

    Args:
        estimates: Those with a pose.
        T_truth: (N, 4, 4) the true pose of each.
    """
    covariance, rows = CovarianceAccumulator(), []
    T_truth_reference = T_truth_last = T_world_last = np.eye(4)
    for number, (estimate, T_camera) in enumerate(zip(estimates, T_truth, strict=True)):
        if number == 0 or estimate.is_reset:
            covariance.reset()
        else:
            T_last_camera = inverse(T_world_last) @ estimate.T_world_camera
            covariance.add(estimate, T_last_camera)
            since = inverse(T_truth_reference) @ T_camera
            step = inverse(T_truth_last) @ T_camera
            rows.append(
                (
                    nees(since, estimate.T_reference_camera, estimate.covariance),
                    nees(step, T_last_camera, covariance.step),
                )
            )
        if number == 0 or estimate.is_next_reference:
            T_truth_reference = T_camera
        T_truth_last, T_world_last = T_camera, estimate.T_world_camera
    return np.array(rows).reshape(-1, 2)


def measure(method: str, folder: Path) -> Array:
    """Normalized errors of a method on a TUM folder.

    Raises:
        InputError: A frame has no true pose.
    """
    with open_frames_with_truth(folder) as (frames, truth):
        tracked = track(method, frames)
    stamps_s = tracked.trajectory.stamps_s
    estimates = [estimate for estimate in tracked.estimates if estimate.ok]
    return normalized_errors(estimates, true_poses(truth, stamps_s, folder))


def true_poses(truth: Trajectory, stamps_s: Array, folder: Path) -> Array:
    """Return the true pose (N, 4, 4) of each frame. Raises InputError if one has none."""
    indices = nearest_indices(truth.stamps_s, stamps_s)
    missing = np.abs(truth.stamps_s[indices] - stamps_s) > STAMP_ROUNDING_S
    if missing.any():
        stamp_s = stamps_s[missing][0]
        raise InputError(f"{folder}: no true pose at {stamp_s:.6f} s; every frame needs one")
    return truth.T_world_camera[indices]


@option("folder", nargs="*", type=Path, help="TUM folder with ground truth")
@option("--rooms", type=Path, metavar="FOLDER", help="render rooms into this folder")
@option("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms")
@option("--processes", type=int, default=1, help="rendering processes")
@METHOD
def main(args: argparse.Namespace) -> None:
    """Render missing rooms, measure and print."""
    folders = list(args.folder)
    if args.rooms:
        folders += render_all(args.rooms, make_configs(args.seeds), args.processes).values()
    if not folders:
        raise InputError("nothing to measure: name a folder, or --rooms FOLDER")
    print(TABLE.head)
    together = []
    for folder in folders:
        together.append(measure(args.method, folder))
        print(format_row(folder.name, together[-1]), flush=True)
    print(format_row("together", np.concatenate(together)))


def format_row(name: str, errors: Array) -> str:
    """One row of the table."""
    means = errors.mean(axis=0) / DEGREES_OF_FREEDOM if len(errors) else [None, None]
    shares = 100 * np.mean(errors <= CHI2_95_PERCENT, axis=0) if len(errors) else [None, None]
    return TABLE.row(name, len(errors), means[0], shares[0], means[1], shares[1])
