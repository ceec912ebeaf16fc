"""Consistency of a method's covariance: its errors compared with the covariance it reports.

    python -m benchmarks covariance FOLDER... [--method direct]
    python -m benchmarks covariance --rooms FOLDER [--seeds 101 102 ...]

Each FOLDER is a TUM folder with an exact ground truth. --rooms renders five seconds for each seed
and stores them in FOLDER; room, motion and sensor timing differ. "since" is the motion since the
reference (for `direct` the keyframe). "step" is the motion since the previous frame, with the
covariance that the service publishes for it. "mean" is the normalized squared error (NEES) per
degree of freedom: 1 is consistent, more is overconfident. "in 95 %" is how often the 95 % ellipsoid
contains the truth.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

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
# 95 % quantile of chi squared with six degrees of freedom.
CHI2_95_PERCENT = 12.592


@dataclass(frozen=True)
class NeesStatistics:
    """NEES of many motions.

    Attributes:
        count: Number of motions.
        mean_per_dof: Mean NEES per degree of freedom. 1 is consistent, more is overconfident,
            less is too conservative.
        fraction_within_95: Fraction of motions whose 95 % ellipsoid holds the truth.
    """

    count: int
    mean_per_dof: float
    fraction_within_95: float


def motion_error(T_true: Array, T_estimated: Array) -> Array:
    """Return the error (6,) of a 4x4 motion in its end frame: translation m, rotation rad."""
    T_error = inverse(T_true) @ T_estimated
    return np.concatenate([T_error[:3, 3], so3_log(T_error[:3, :3])])


def nees(error: Array, covariance: Array) -> float:
    """Return the NEES x^T C^-1 x of an error x (6,) with covariance C (6, 6)."""
    return float(error @ np.linalg.solve(covariance, error))


def summarize_nees(nees_values: Sequence[float]) -> NeesStatistics | None:
    """Return the statistics of many NEES values, or None without a value."""
    if not nees_values:
        return None
    values = np.array(nees_values)
    return NeesStatistics(
        count=len(values),
        mean_per_dof=float(values.mean()) / DEGREES_OF_FREEDOM,
        fraction_within_95=float(np.mean(values <= CHI2_95_PERCENT)),
    )


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


@dataclass
class NormalizedErrors:
    """Normalized squared errors (NEES) since the reference, and of single steps."""

    since_reference: list[float] = field(default_factory=list)
    step: list[float] = field(default_factory=list)

    def extend(self, others: "NormalizedErrors") -> None:
        """Append the errors of another sequence."""
        self.since_reference += others.since_reference
        self.step += others.step


class NormalizedErrorCollector:
    """Compares the motions of a run with the truth and collects the normalized errors."""

    def __init__(self) -> None:
        self.squares = NormalizedErrors()
        self._covariance = CovarianceAccumulator()
        self._has_begun = False
        self._T_truth_reference = self._T_truth_last = self._T_world_last = np.eye(4)

    def add(self, estimate: Estimate, T_truth_camera: Array) -> None:
        """Add the next good estimate and the true pose."""
        if self._has_begun and not estimate.is_reset:
            self._add_errors(estimate, T_truth_camera)
        else:
            self._covariance.reset()
        if estimate.is_next_reference or not self._has_begun:
            self._T_truth_reference = T_truth_camera
        self._T_truth_last, self._T_world_last = T_truth_camera, estimate.T_world_camera
        self._has_begun = True

    def _add_errors(self, estimate: Estimate, T_truth_camera: Array) -> None:
        since_true = inverse(self._T_truth_reference) @ T_truth_camera
        since = motion_error(since_true, estimate.T_reference_camera)
        T_last_camera = inverse(self._T_world_last) @ estimate.T_world_camera
        step = motion_error(inverse(self._T_truth_last) @ T_truth_camera, T_last_camera)
        self._covariance.add(estimate, T_last_camera)
        self.squares.since_reference.append(nees(since, estimate.covariance))
        self.squares.step.append(nees(step, self._covariance.step))


def _measure(method: str, folder: Path) -> NormalizedErrors:
    """Run a method on a TUM folder. Raises InputError if a frame has no true pose."""
    collector = NormalizedErrorCollector()
    with open_frames_with_truth(folder) as (frames, truth):
        tracked = track(method, frames)
    for stamp_s, estimate in zip(tracked.stamps_s, tracked.estimates, strict=True):
        if estimate.ok:
            collector.add(estimate, _true_pose(truth, stamp_s, folder))
    return collector.squares


def _true_pose(truth: Trajectory, stamp_s: float, folder: Path) -> Array:
    """Return the true pose (4, 4) of a frame. Raises InputError if there is none."""
    index = int(nearest_indices(truth.stamps_s, np.array([stamp_s]))[0])
    if abs(truth.stamps_s[index] - stamp_s) > STAMP_ROUNDING_S:
        raise InputError(f"{folder}: no true pose at {stamp_s:.6f} s; every frame needs one")
    T_truth_camera: Array = truth.T_world_camera[index]
    return T_truth_camera


@option("folder", nargs="*", type=Path, help="TUM folder with ground truth")
@option("--rooms", type=Path, metavar="FOLDER", help="render rooms into this folder")
@option("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms")
@option("--processes", type=int, default=1, help="rendering processes")
@METHOD
def main(args: argparse.Namespace) -> None:
    """Render missing rooms, measure and print."""
    print(TABLE.head)
    together = NormalizedErrors()
    for folder in _folders(args):
        squares = _measure(args.method, folder)
        together.extend(squares)
        print(_format_row(folder.name, squares), flush=True)
    print(_format_row("together", together))


def _folders(args: argparse.Namespace) -> list[Path]:
    """Folders to measure; missing rooms are rendered."""
    if args.rooms is None:
        if not args.folder:
            raise InputError("nothing to measure: name a folder, or --rooms FOLDER")
        return list(args.folder)
    rooms = render_all(args.rooms, make_configs(args.seeds), args.processes)
    return [*args.folder, *rooms.values()]


def _format_row(name: str, squares: NormalizedErrors) -> str:
    cells: list[float] = []
    for values in (squares.since_reference, squares.step):
        statistics = summarize_nees(values)
        if statistics is None:
            return f"{name:42}{0:8}"
        cells += [statistics.mean_per_dof, 100 * statistics.fraction_within_95]
    return TABLE.row(name, len(squares.step), *cells)
