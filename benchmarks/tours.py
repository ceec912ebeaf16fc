"""Long tours of the virtual Kinect with revisited places: drift, loop closure, time and memory.

    python -m benchmarks tours FOLDER [--seconds 600] [--seeds 1 2 3] [--twins] [--plot FILE]

Each seed is another room and another tour. Frames are rendered on demand and not stored: that takes
0.11 s of processor time per frame, or a quarter of an hour on two idle cores for ten minutes.
FOLDER stores the arrays of each tour (stamps, truth, poses, milliseconds, memory) as .npz, and the
figures in results.json. Finished tours are not run again; remove FOLDER to measure again. With
--twins two corners of the room look the same.

"ATE" is that of all estimated poses, in millimeters; "with loops" that of the optimized poses at
the end. Gross errors are steps, and wrong loops are loop closures, with an error above 5 cm or 3
degrees. CPU is that of the pose thread, milliseconds per frame in the first and in the last minute.
MB is the memory of the whole program in these minutes, including the virtual Kinect.
"""

import argparse
import math
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness import Json, ResultCache, add_json_option, make_printer, print_json
from benchmarks.rendered_views import compute_true_poses, make_tour_config, render_frames
from benchmarks.tour_record import (
    LoopClosureRecord,
    TourRecord,
    TrajectoryRunner,
    make_runner,
    save_plot,
)
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, inverse, poses_close
from drivers.synthetic import SyntheticConfig
from vo_service.odometry import METHODS, warm_up
from vo_service.terminal import Terminal
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.metrics import (
    GROSS_ERROR_DEG,
    GROSS_ERROR_M,
    associate,
    count_gross_errors,
    tracked_steps,
)

MINUTE_S = 60.0
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
COLUMNS = ("frames", "cover %", "epochs", "gross", "ATE", "with loops", "loop_closures", "wrong")
PAIRS = f"{'CPU ms':>15}{'of loops':>15}{'MB':>13}"
HEAD = f"{'':30}{''.join(f'{head:>11}' for head in COLUMNS)}{PAIRS}"


@dataclass(frozen=True)
class TourResult:
    """The figures of one tour. None: could not be computed.

    Attributes:
        frames: Number of frames.
        coverage: Fraction of the frames with a pose.
        epochs: Epochs begun after the first.
        gross: Tracked steps with an error above 5 cm or 3 degrees.
        ate_m: ATE of the poses as they were estimated.
        ate_optimized_m: ATE of the optimized poses at the end.
        loop_closures: Number of loop closures.
        wrong_loop_closures: Those with an error above 5 cm or 3 degrees.
        cpu_ms: Mean time of a pose, in the first and in the last minute.
        loop_closure_ms: Mean time of the map's work per frame, likewise.
        memory_mb: Mean memory, likewise.
    """

    frames: int
    coverage: float
    epochs: int
    gross: int
    ate_m: float | None
    ate_optimized_m: float | None
    loop_closures: int
    wrong_loop_closures: int
    cpu_ms: tuple[float, float]
    loop_closure_ms: tuple[float, float]
    memory_mb: tuple[float, float]


def run_tour(
    runner: TrajectoryRunner,
    frames: Iterable[RgbdFrame],
    T_room_camera: Array,
    progress: Callable[[int, int], None],
) -> TourRecord:
    """Run all frames without storing them.

    Args:
        runner: The method.
        frames: The frames.
        T_room_camera: Their true poses (N, 4, 4).
        progress: Called after each frame.
    """
    stamps_s, poses, ok, is_reset = [], [], [], []
    cpu_ms, loop_closure_ms, memory_mb = [], [], []
    for frame in frames:
        begin_s = time.thread_time()
        estimate = runner.estimate_pose(frame)
        estimated_s = time.thread_time()
        runner.update_map()
        cpu_ms.append((estimated_s - begin_s) * 1e3)
        loop_closure_ms.append((time.thread_time() - estimated_s) * 1e3)
        stamps_s.append(frame.stamp_s)
        poses.append(estimate.T_world_camera)
        ok.append(estimate.ok)
        is_reset.append(estimate.is_reset)
        memory_mb.append(resident_mb())
        progress(len(stamps_s), len(T_room_camera))
    stamp_s, T_world_camera, is_ok = np.array(stamps_s), np.array(poses), np.array(ok, np.bool_)
    trajectory = Trajectory(stamp_s[is_ok], T_world_camera[is_ok])
    return TourRecord(
        stamp_s,
        T_room_camera[: len(stamps_s)],
        T_world_camera,
        is_ok,
        np.cumsum(is_reset),
        np.array(cpu_ms),
        np.array(loop_closure_ms),
        np.array(memory_mb),
        runner.optimized_trajectory(trajectory),
        tuple(runner.loop_closures()),
    )


def resident_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * PAGE_BYTES / 1e6


def summarize(record: TourRecord) -> TourResult:
    """Compute the figures of a tour."""
    wrong = [loop for loop in record.loop_closures if is_wrong_loop(loop, record)]
    return TourResult(
        frames=len(record.has_pose),
        coverage=float(record.has_pose.mean()),
        epochs=int(record.epoch[-1]),
        gross=_count_gross_errors(record),
        ate_m=_ate_m(record.trajectory, record.truth),
        ate_optimized_m=_ate_m(record.optimized, record.truth),
        loop_closures=len(record.loop_closures),
        wrong_loop_closures=len(wrong),
        cpu_ms=_first_and_last(record.cpu_ms, record.stamp_s),
        loop_closure_ms=_first_and_last(record.loop_closure_ms, record.stamp_s),
        memory_mb=_first_and_last(record.memory_mb, record.stamp_s),
    )


def is_wrong_loop(loop: LoopClosureRecord, record: TourRecord) -> bool:
    """Whether a loop closure has a gross error."""
    keyframe, camera = np.searchsorted(record.stamp_s, [loop.keyframe_stamp_s, loop.stamp_s])
    true = inverse(record.T_room_camera[keyframe]) @ record.T_room_camera[camera]
    return not poses_close(
        true, loop.T_keyframe_camera, GROSS_ERROR_M, math.radians(GROSS_ERROR_DEG)
    )


def _count_gross_errors(record: TourRecord) -> int:
    try:
        matched = associate(record.trajectory, record.truth)
    except InputError:
        return 0
    steps = tracked_steps(matched, record.trajectory.stamps_s, record.epoch[record.has_pose])
    return count_gross_errors(matched, steps)


def _ate_m(trajectory: Trajectory, truth: Trajectory) -> float | None:
    try:
        return evaluate(trajectory, truth).ate_rmse_m
    except InputError:
        return None


def _first_and_last(values: Array, stamps_s: Array) -> tuple[float, float]:
    """Mean values of the first and of the last minute."""
    first = values[stamps_s < stamps_s[0] + MINUTE_S]
    last = values[stamps_s > stamps_s[-1] - MINUTE_S]
    return float(first.mean()), float(last.mean())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path, help="folder of the results")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of a tour")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--twins", action="store_true", help="two corners look the same")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="error, CPU and memory over time")
    parser.add_argument(
        "--alone", action="store_true", help="only the odometry, without loop closure"
    )
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Run the tours without stored results, and print all."""
    results = run(args)
    if args.plot:
        names = {name: args.folder / f"{name}.npz" for name in results}
        save_plot({name: TourRecord.load(file) for name, file in names.items()}, args.plot)
    print_json(args, results)


def run(args: argparse.Namespace) -> dict[str, Json]:
    """Figures of each tour by name. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache, results = ResultCache(args.folder), dict[str, Json]()
    warm_up(args.method, lambda stage: None)
    print_line = make_printer(args)
    print_line(HEAD)
    for seed in args.seeds:
        alone = "-alone" if args.alone else ""
        name = f"{'twins' if args.twins else 'tour'}-{args.seconds:g}s-{seed}-{args.method}{alone}"
        config = make_tour_config(seed, args.seconds, args.twins)
        results[name] = cache.get_or_run(name, partial(_measure, args, config, name))
        print_line(format_row(name, results[name]))
    return results


def _measure(args: argparse.Namespace, config: SyntheticConfig, name: str) -> Json:
    terminal = Terminal()
    progress = terminal.progress_callback(f"{name}: frame")
    record = run_tour(
        make_runner(args.method, args.alone),
        render_frames(config),
        compute_true_poses(config),
        progress,
    )
    record.save(args.folder / f"{name}.npz")
    terminal.clear()
    return asdict(summarize(record))


def format_row(name: str, result: Json) -> str:
    """One row of the table."""
    cells = [
        f"{result['frames']}",
        f"{100.0 * result['coverage']:.1f}",
        f"{result['epochs']}",
        f"{result['gross']}",
        _format_mm(result["ate_m"]),
        _format_mm(result["ate_optimized_m"]),
        f"{result['loop_closures']}",
        f"{result['wrong_loop_closures']}",
    ]
    row = "".join(f"{cell:>11}" for cell in cells)
    times = (
        f"{_format_pair(result['cpu_ms'], 2):>15}{_format_pair(result['loop_closure_ms'], 2):>15}"
    )
    return f"{name:30}{row}{times}{_format_pair(result['memory_mb'], 0):>13}"


def _format_mm(value_m: float | None) -> str:
    return "-" if value_m is None else f"{1e3 * value_m:.1f}"


def _format_pair(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
