"""Tracking in hard cases: a table with one row for each case.

    python -m benchmarks hard_cases FOLDER [--method direct] [--only dark wall] [--json]

FOLDER stores the sequences of config/sequences, which are rendered the first time (twenty minutes
of one core). A gross error is a step with an error above 5 cm or 3 degrees; in brackets are those
at a frame in state `tracking`. "longest" is the longest time without a pose. "recovery" is the
longest time from the end of a fault until a frame in state `tracking`. ATE and largest error are
over all poses, in millimeters. "slow" creeps at a millimeter per second for a minute. "still"
stands still for --still-frames frames with fresh noise in each (an hour is 108000).
"""

import argparse
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import add_json_option, make_printer, print_json
from benchmarks.rendered_sequences import StaticView, render_all
from benchmarks.tracking import HardCaseResult, measure, read_all_frames, track
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.geometry import Array, inverse, rotation_angle_rad
from drivers.recording_camera import RecordingCamera
from drivers.synthetic import SyntheticConfig
from vo_service.config import read_config
from vo_service.odometry import METHODS, CpuStageTimer, MethodConfig, warm_up
from vo_service.tools.evaluation.metrics import associate

SEQUENCES = Path(__file__).parents[1] / "config" / "sequences"
SLOW, STILL = "slow", "still"
FAULT_CASES = (
    "object-8",
    "object-20",
    "person",
    "wall",
    "dark",
    "covered",
    "gap",
    "fast-turn",
    "floor",
)
CASES = (*FAULT_CASES, SLOW, STILL)
STILL_FRAMES = 9000
HEAD = (
    f"{'':12}{'frames':>8}{'degraded':>10}{'lost':>6}{'epochs':>8}{'gross':>9}{'longest s':>11}"
    f"{'recovery s':>12}{'ATE':>8}{'largest':>9}"
)


@dataclass(frozen=True)
class StationaryResult:
    """Distance from the first pose, at most and in the last frame."""

    frames: int
    lost: int
    max_error_m: float
    max_error_deg: float
    end_m: float
    end_deg: float


@dataclass(frozen=True)
class CreepResult:
    """Tracked distance of a slow motion, projected onto the true motion, and the true distance."""

    frames: int
    lost: int
    true_distance_m: float
    tracked_distance_m: float


CaseResult = HardCaseResult | CreepResult | StationaryResult


def measure_stationary(method: str, frames: Iterable[RgbdFrame]) -> StationaryResult:
    """Track a camera that never moves, without storing its frames."""
    odometry = METHODS[method](MethodConfig(), CpuStageTimer())
    lost, count = 0, 0
    farthest, end = np.zeros(2), np.zeros(2)
    T_camera_first = np.eye(4)
    for frame in frames:
        estimate = odometry.estimate(frame)
        count += 1
        if not estimate.ok:
            lost += 1
            continue
        if count == lost + 1:
            T_camera_first = inverse(estimate.T_world_camera)
        end = _size(T_camera_first @ estimate.T_world_camera)
        farthest = np.maximum(farthest, end)
    return StationaryResult(count, lost, *map(float, (*farthest, *end)))


def measure_creep(method: str, folder: Path) -> CreepResult:
    """Track a sequence of the motion "creep". Raises InputError with too few poses."""
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        tracked = track(method, read_all_frames(camera))
        truth = camera.ground_truth
    assert truth is not None, "a rendered sequence has a ground truth"
    matched = associate(tracked.trajectory, truth)
    true_way = _displacement_m(matched.T_truth_camera)
    length_m = float(np.linalg.norm(true_way))
    followed_m = float(_displacement_m(matched.T_world_camera) @ true_way) / length_m
    lost = int(np.count_nonzero(~tracked.has_pose))
    return CreepResult(len(tracked.stamps_s), lost, length_m, followed_m)


def _displacement_m(T_world_camera: Array) -> Array:
    """Displacement (3,) from the first pose to the last, in the axes of the first camera."""
    displacement_m: Array = (inverse(T_world_camera[0]) @ T_world_camera[-1])[:3, 3]
    return displacement_m


def _size(T: Array) -> Array:
    """Distance in meters and angle in degrees of a motion."""
    return np.array([np.linalg.norm(T[:3, 3]), np.degrees(rotation_angle_rad(T[:3, :3]))])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path, help="folder of the sequences")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--only", nargs="+", choices=CASES, default=CASES, metavar="CASE")
    parser.add_argument("--still-frames", type=int, default=STILL_FRAMES)
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Render, measure and print."""
    print_line = make_printer(args)
    results = _run(args.folder, args.method, args.only, args.still_frames, print_line)
    print_json(args, results)


def _run(
    folder: Path,
    method: str,
    names: list[str],
    still_frames: int,
    print_line: Callable[[str], None],
) -> Mapping[str, CaseResult]:
    """Measure each case and print its row. Raises as `render_all`."""
    configs = {name: case_config(name) for name in names}
    folder.mkdir(parents=True, exist_ok=True)
    longest_first = sorted(names, key=lambda name: -configs[name].frame_count)
    sequences = {folder / name: configs[name] for name in longest_first if name != STILL}
    render_all(sequences, print_line, os.cpu_count() or 1)
    warm_up(method, lambda stage: None)
    results: dict[str, CaseResult] = {}
    for name in (name for name in CASES if name in names):
        if not results:
            print_line(f"{method}\n{HEAD}")
        results[name] = _measure_case(name, folder / name, configs[name], method, still_frames)
        print_line(f"{name:12}{format_row(results[name])}")
    return results


def case_config(name: str) -> SyntheticConfig:
    """Read the configuration of a case."""
    return replace(read_config(SEQUENCES / f"{name}.toml").synthetic, loop=False)


def _measure_case(
    name: str, folder: Path, config: SyntheticConfig, method: str, still_frames: int
) -> CaseResult:
    if name == STILL:
        return measure_stationary(method, StaticView.render(config).frames(still_frames))
    if name == SLOW:
        return measure_creep(method, folder)
    return measure(method, folder, config)


def format_row(figures: CaseResult) -> str:
    """One row of the table, without the name."""
    match figures:
        case HardCaseResult():
            gross = f"{figures.gross} ({figures.gross_tracking})"
            return (
                f"{figures.frames:8}{figures.degraded:10}{figures.lost:6}{figures.epochs:8}"
                f"{gross:>9}{figures.longest_gap_s:11.2f}"
                f"{_format_number(figures.recovery_s, 1.0, 12, 2)}"
                f"{_format_number(figures.ate_m, 1e3, 8, 1)}"
                f"{_format_number(figures.max_error_m, 1e3, 9, 1)}"
            )
        case CreepResult():
            share = 100.0 * figures.tracked_distance_m / figures.true_distance_m
            return (
                f"{figures.frames:8}{'':10}{figures.lost:6}    "
                f"{1e3 * figures.tracked_distance_m:.2f} of "
                f"{1e3 * figures.true_distance_m:.2f} mm: {share:.1f} %"
            )
        case StationaryResult():
            return (
                f"{figures.frames:8}{'':10}{figures.lost:6}    "
                f"at most {1e3 * figures.max_error_m:.3f} mm and "
                f"{figures.max_error_deg:.4f} degrees away, in the end "
                f"{1e3 * figures.end_m:.3f} mm and {figures.end_deg:.4f} degrees"
            )


def _format_number(value: float | None, scale: float, width: int, digits: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{scale * value:{width}.{digits}f}"
