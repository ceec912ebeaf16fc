"""Sensitivity of a method to tiny changes of a recording, and its accuracy beside the baselines.

    python -m benchmarks perturbations KEPT FOLDER... [--method direct] [--count 20] [--verbose]

FOLDER is a TUM folder with ground truth, best of a real Kinect. Each perturbation changes the focal
length by up to 0.5 px, the delay of depth by up to 0.3 ms, and each pixel's brightness by -1, 0 or
1 gray level, at random but the same in every run. Errors of a robust method hardly change: the
largest should be at most 1.5 times the smallest. The baselines run on the unchanged frames; "best"
is the best of them, and the method's error should be at most 1.1 times that.

ATE RMSE and RPE over a second are in millimeters; "failed" are frames without a pose. Finished runs
are stored in KEPT/results.json, and the same command continues with the next. Remove KEPT when the
odometry has changed.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import Json, ResultCache
from benchmarks.tracking import FrameChange, track_changed
from drivers.camera import RgbdFrame
from vo_service.odometry import DEFAULT_METHOD, METHODS, warm_up

MAX_FOCAL_ERROR_PX = 0.5
MAX_DELAY_ERROR_S = 0.0003
BASELINES = ("surf", "icp", "sfm")
UNCHANGED = "unchanged"
FIGURES = {"ATE": "ate_m", "RPE/1s": "rpe_1s_m", "failed": "failed"}
SPREAD_HEAD = "".join(f"{head:>11}" for head in (UNCHANGED, "smallest", "median", "largest"))


@dataclass(frozen=True)
class Perturbation:
    """A tiny change of all frames of a recording."""

    seed: int
    focal_px: float
    delay_s: float

    def __str__(self) -> str:
        return f"{self.seed}: {self.focal_px:+.2f} px {1e3 * self.delay_s:+.2f} ms"

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Change a frame; its noise depends on the seed and the frame's number alone."""
        rng = np.random.default_rng([self.seed, frame.seq])
        noise = rng.integers(-1, 2, (*frame.depth_raw.shape, 1), np.int16)
        camera = frame.camera
        return replace(
            frame,
            color_bgr=np.clip(frame.color_bgr + noise, 0, 255).astype(np.uint8),
            camera=replace(camera, fx=camera.fx + self.focal_px, fy=camera.fy + self.focal_px),
            skew_s=frame.skew_s + self.delay_s,
        )


def make_perturbation(seed: int) -> Perturbation:
    """Draw the perturbation of a seed."""
    focal, delay = np.random.default_rng(seed).uniform(-1.0, 1.0, 2).tolist()
    return Perturbation(seed, MAX_FOCAL_ERROR_PX * focal, MAX_DELAY_ERROR_S * delay)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("kept", metavar="KEPT", type=Path, help="folder of stored results")
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder with ground truth")
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD)
    parser.add_argument("--count", type=int, default=20, help="perturbations of each recording")
    parser.add_argument("--verbose", action="store_true", help="print each perturbation")


def main(args: argparse.Namespace) -> None:
    """Run what has no stored result, and print all."""
    args.kept.mkdir(parents=True, exist_ok=True)
    runs = StoredRuns(ResultCache(args.kept))
    for method in {args.method, *BASELINES}:
        warm_up(method, lambda stage: None)
    for folder in args.folder:
        _print_recording(runs, folder, args)


@dataclass(frozen=True)
class StoredRuns:
    """Runs of methods on recordings, each at most once."""

    cache: ResultCache

    def run(self, method: str, folder: Path, name: str, change: FrameChange) -> Json:
        """Accuracy of a method on changed frames; `name` identifies the change."""

        def measure() -> Json:
            return asdict(track_changed(method, folder, change)[1])

        return self.cache.get_or_run(f"{folder.resolve()} {method} {name}", measure)


def _print_recording(runs: StoredRuns, folder: Path, args: argparse.Namespace) -> None:
    print(folder)
    methods = list(dict.fromkeys((args.method, *BASELINES)))
    unchanged = {
        method: runs.run(method, folder, UNCHANGED, lambda frame: frame) for method in methods
    }
    changed: list[Json] = []
    for perturbation in (make_perturbation(seed) for seed in range(1, args.count + 1)):
        changed.append(runs.run(args.method, folder, str(perturbation), perturbation.apply))
        if args.verbose:
            print(f"  {perturbation!s:26}" + format_figures(changed[-1]), flush=True)
    print(format_spread(args.method, unchanged[args.method], changed))
    print(format_baselines(args.method, unchanged), flush=True)


def format_spread(method: str, unchanged: Json, changed: Sequence[Json]) -> str:
    """A row for each figure: without change, and the range over all perturbations.

    Args:
        method: The method.
        unchanged: Accuracy without change.
        changed: Accuracy of each perturbation.
    """
    lines = [f"{f'{method}, {len(changed)} perturbations':28}{SPREAD_HEAD}{'ratio':>11}"]
    for label, key in FIGURES.items():
        values = [result[key] for result in changed]
        if any(value is None for value in values):
            values = []
        spread = [min(values), float(np.median(values)), max(values)] if values else [None] * 3
        cells = [format_figure(key, value) for value in (unchanged[key], *spread)]
        ratio = "" if key == "failed" else format_ratio(spread[2], spread[0])
        lines.append(f"{label:28}" + "".join(f"{cell:>11}" for cell in (*cells, ratio)).rstrip())
    return "\n".join(lines)


def format_baselines(method: str, unchanged: Mapping[str, Json]) -> str:
    """A row for each method on the unchanged frames, then the ratio to the best baseline."""
    lines = [f"{'unchanged frames':28}" + "".join(f"{head:>11}" for head in FIGURES)]
    lines += [f"{name:28}{format_figures(result)}" for name, result in unchanged.items()]
    ratios = []
    for key in ("ate_m", "rpe_1s_m"):
        others = [result[key] for name, result in unchanged.items() if name != method]
        best = min((error for error in others if error is not None), default=None)
        ratios.append(format_ratio(unchanged[method][key], best))
    return "\n".join([*lines, f"{f'{method}/best':28}" + "".join(f"{cell:>11}" for cell in ratios)])


def format_figures(result: Json) -> str:
    """The columns of one run."""
    return "".join(f"{format_figure(key, result[key]):>11}" for key in FIGURES.values())


def format_figure(key: str, value: float | None) -> str:
    """A figure by its key; "-" for None."""
    if value is None:
        return "-"
    return f"{value:g}" if key == "failed" else f"{1e3 * value:.2f}"


def format_ratio(error: float | None, other: float | None) -> str:
    """Ratio of two errors; "-" if one is missing."""
    return "-" if error is None or not other else f"{error / other:.2f}"
