"""SURF compared with SIFT and ORB: repeatability, matching and cost of the features.

    python -m benchmarks features                            # views of the virtual Kinect's room
    python -m benchmarks features recordings/desk photo.jpg  # frames of recordings, and pictures

Each image is rotated, zoomed, tilted, blurred, relit and made noisy by 34 known transforms;
distances are in pixels of the original. Repeatability: fraction of the features inside both images
that are repeated within 2 px at a scale within a factor of 1.5. Score: fraction of the same
features that are matched within 3 px (nearest descriptor, ratio test 0.8). Precision: fraction of
all matches that are correct. The columns of the transform groups count correct matches.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.feature_scores import (
    FeatureMethod,
    FeatureScore,
    Gray,
    all_transforms,
    make_all_methods,
    score_features,
)
from benchmarks.harness import add_json_option, format_table, make_printer, print_json
from drivers.core import InputError
from drivers.synthetic import SyntheticConfig
from drivers.synthetic.camera import SyntheticCamera
from drivers.tum import read_frame_pairs

SYNTHETIC = SyntheticConfig(duration_s=18.0, rate_hz=1 / 3)  # six views, far apart
TIMING_ROUNDS = 5


@dataclass(frozen=True)
class FeatureBenchmarkResult:
    """Means of one method over all images and transforms.

    `repeatability`, `score` and `precision` are 0 to 1. `correct` are correct matches per pair of
    images. `error_px` is the median error of correct matches. `features`, `cpu_ms` and
    `cpu_us_per_feature` are those of an original image, on one thread.
    """

    features: float
    repeatability: float
    score: float
    precision: float
    correct: float
    correct_by_change: dict[str, float]
    error_px: float
    cpu_ms: float
    cpu_us_per_feature: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "source", nargs="*", type=Path, help="TUM folder or image (default: the virtual Kinect)"
    )
    parser.add_argument("--frames", type=int, default=2, help="frames of each folder (2)")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    images = list(load_images(args.source, args.frames))
    results = {}
    for name, method in make_all_methods().items():
        print(f"measuring {name} ...", file=sys.stderr)
        results[name] = measure(method, images)
    print_line = make_printer(args)
    print_line(f"{len(images)} images, {len(all_transforms())} transforms of each")
    print_line(format_scores(results))
    print_json(args, results)


def load_images(sources: list[Path], frames: int) -> Iterator[Gray]:
    """Yield gray images of folders (`frames` each, evenly spread) and files.

    Without sources they are views of the virtual Kinect. Raises InputError if one cannot be read.
    """
    if not sources:
        with SyntheticCamera(SYNTHETIC) as camera:
            for _ in range(SYNTHETIC.frame_count):
                yield camera.read(timeout_s=60.0).gray
    for source in sources:
        for file in sample_images(source, frames) if source.is_dir() else [source]:
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise InputError(f"{file}: not a readable image")
            yield np.asarray(image, np.uint8)


def sample_images(folder: Path, count: int) -> list[Path]:
    """Color images of `count` frames of a folder, evenly spread from first to last."""
    pairs = read_frame_pairs(folder).pairs
    chosen = np.unique(np.linspace(0, len(pairs) - 1, max(count, 1)).round().astype(int))
    return [pairs[i].color.file for i in chosen]


def measure(method: FeatureMethod, images: list[Gray]) -> FeatureBenchmarkResult:
    """Measure a method on all transforms of all images, and its time on the originals."""
    cpu_s, features = np.mean([measure_cost(method, image) for image in images], axis=0)
    scores = [pair for image in images for pair in score_method(method, image)]
    every = [score for _, score in scores]
    groups = dict.fromkeys(group for group, _ in scores)
    return FeatureBenchmarkResult(
        features=float(features),
        repeatability=mean([s.repeated / s.max_repeatable for s in every if s.max_repeatable]),
        score=mean([s.correct / s.max_repeatable for s in every if s.max_repeatable]),
        precision=mean([s.correct / s.matches for s in every if s.matches]),
        correct=mean([s.correct for s in every]),
        correct_by_change={
            group: mean([s.correct for kind, s in scores if kind == group]) for group in groups
        },
        error_px=float(np.median(np.concatenate([s.errors_px for s in every]))),
        cpu_ms=float(1e3 * cpu_s),
        cpu_us_per_feature=float(1e6 * cpu_s / features),
    )


def score_method(method: FeatureMethod, image: Gray) -> Iterator[tuple[str, FeatureScore]]:
    """Yield the group and the score of each transform of an image."""
    size = (image.shape[1], image.shape[0])
    original = method(image)
    for change in all_transforms():
        changed = method(change.apply(image))
        yield change.group, score_features(original, changed, change.homography(image), size)


def measure_cost(method: FeatureMethod, image: Gray) -> tuple[float, int]:
    """Measure CPU seconds (median after a round that compiles) and the number of features."""
    features = len(method(image))
    spent_s = []
    for _ in range(TIMING_ROUNDS):
        start_s = time.process_time()
        method(image)
        spent_s.append(time.process_time() - start_s)
    return float(np.median(spent_s)), features


def mean(values: list[float]) -> float:
    """Arithmetic mean; 0 for no values."""
    return float(np.mean(values)) if values else 0.0


def format_scores(results: dict[str, FeatureBenchmarkResult]) -> str:
    """Format the table, one line for each method."""
    groups = list(next(iter(results.values())).correct_by_change)
    heads = ["features", "repeat.", "score", "precision", "correct", *groups]
    heads += ["error px", "CPU ms", "us/feature"]
    rows = {}
    for name, r in results.items():
        cells = [f"{r.features:.0f}"]
        cells += [f"{share:.3f}" for share in (r.repeatability, r.score, r.precision)]
        cells += [f"{count:.0f}" for count in (r.correct, *r.correct_by_change.values())]
        cells += [f"{r.error_px:.2f}", f"{r.cpu_ms:.1f}", f"{r.cpu_us_per_feature:.1f}"]
        rows[name] = cells
    return format_table(heads, rows)
