"""Long tours of the virtual Kinect with revisited places: drift, loop closure, time and memory.

    python -m benchmarks.tours FOLDER [--seconds 600] [--seeds 1 2 3] [--twins] [--plot FILE]

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

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2

from benchmarks.result_cache import Json, ResultCache
from benchmarks.runners import make_runner
from benchmarks.tour_frames import compute_true_poses, make_tour_config, render_frames
from benchmarks.tour_measure import run_tour, summarize
from benchmarks.tour_plot import save_plot
from benchmarks.tour_record import TourRecord
from drivers.core.errors import UserFacingError
from drivers.synthetic.config import SyntheticConfig
from vo_service.odometry.registry import METHODS, warm_up
from vo_service.terminal import Terminal

COLUMNS = ("frames", "cover %", "epochs", "gross", "ATE", "with loops", "loop_closures", "wrong")
PAIRS = f"{'CPU ms':>15}{'of loops':>15}{'MB':>13}"
HEAD = f"{'':30}{''.join(f'{head:>11}' for head in COLUMNS)}{PAIRS}"


def main() -> int:
    """Run the tours without stored results, and print all."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        results = run(args)
        if args.plot:
            names = {name: args.folder / f"{name}.npz" for name in results}
            save_plot({name: TourRecord.load(file) for name, file in names.items()}, args.plot)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command continues with the next tour", file=sys.stderr)
        return 130
    if args.json:
        print(json.dumps(results))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tours",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="folder of the results")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of a tour")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--twins", action="store_true", help="two corners look the same")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="error, CPU and memory over time")
    parser.add_argument(
        "--alone", action="store_true", help="only the odometry, without loop closure"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def run(args: argparse.Namespace) -> dict[str, Json]:
    """Figures of each tour by name. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache, results = ResultCache(args.folder), dict[str, Json]()
    warm_up(args.method, lambda stage: None)
    if not args.json:
        print(HEAD)
    for seed in args.seeds:
        alone = "-alone" if args.alone else ""
        name = f"{'twins' if args.twins else 'tour'}-{args.seconds:g}s-{seed}-{args.method}{alone}"
        config = make_tour_config(seed, args.seconds, args.twins)
        results[name] = cache.get_or_run(name, partial(_measure, args, config, name))
        if not args.json:
            print(format_row(name, results[name]), flush=True)
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


if __name__ == "__main__":
    sys.exit(main())
