"""CPU time of each stage of SURF: layers, selection, image pyramid, descriptors.

    python -m benchmarks surf_stages FOLDER... [--frames 50] [--count 1000] [--json]

Each FOLDER is a TUM folder, of which the first frames are used. Times are CPU milliseconds of one
thread: for each frame the median of five rounds, and of these the median. A layer is named by the
lobe of its filter, and has the search for its maxima. "whole" is the extraction as one call.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from benchmarks.feature_scores import Gray
from benchmarks.harness import add_json_option, format_table, make_printer, print_json
from drivers.core import InputError
from drivers.tum import read_frame_pairs
from vo_service.odometry.surf import LAYERS, NEXT_THRESHOLD_RATIO, SurfExtractor
from vo_service.odometry.surf.descriptor import (
    DESCRIPTOR_SIZE,
    build_pyramid,
    describe,
    make_templates,
)
from vo_service.odometry.surf.detector import find_maxima

ROUNDS = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--frames", type=int, default=50, help="frames of each folder (50)")
    parser.add_argument("--count", type=int, default=1000, help="features of a frame (1000)")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    results = {
        str(folder): measure_images(load_images(folder, args.frames), args.count)
        for folder in args.folder
    }
    stages = next(iter(results.values()))
    rows = {stage: [f"{ms[stage]:.2f}" for ms in results.values()] for stage in stages}
    make_printer(args)(format_table([folder.name for folder in args.folder], rows))
    print_json(args, results)


def load_images(folder: Path, frames: int) -> list[Gray]:
    """Gray images of the first frames of a folder; raises InputError if one cannot be read."""
    images = []
    for pair in read_frame_pairs(folder).pairs[: max(frames, 1)]:
        image = cv2.imread(str(pair.color.file), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise InputError(f"{pair.color.file}: not a readable image")
        images.append(np.asarray(image, np.uint8))
    return images


def measure_images(images: list[Gray], count: int) -> dict[str, float]:
    """Milliseconds by stage: medians over the images."""
    extractor = SurfExtractor(count)
    extractor.extract(images[0])  # compiles
    of_images = [measure_stages(extractor, image) for image in images]
    return {stage: float(np.median([ms[stage] for ms in of_images])) for stage in of_images[0]}


def measure_stages(extractor: SurfExtractor, image: Gray) -> dict[str, float]:
    """Milliseconds by stage of one image; the threshold is that of an equal image before."""
    weakest = extractor.extract(image).response.min(initial=np.inf)
    threshold = np.float32(NEXT_THRESHOLD_RATIO * weakest)
    integral = np.empty((image.shape[0] + 1, image.shape[1] + 1), np.int32)
    stages: dict[str, Callable[[], object]] = {
        "integral image": partial(cv2.integral, image, integral)
    }
    for layer in LAYERS:
        name = f"lobe {layer.lobes[1]}, every {layer.step} px"
        stages[name] = partial(find_maxima, integral, layer, threshold)
    keypoints = extractor.detect(image)
    strongest = extractor.select_strongest(keypoints)
    stages["selection"] = lambda: extractor.select_strongest(keypoints)
    pyramid, templates = build_pyramid(image), make_templates()
    directions = np.empty((len(strongest), 2), np.float32)
    descriptors = np.empty((len(strongest), DESCRIPTOR_SIZE), np.float32)
    stages["image pyramid"] = partial(build_pyramid, image, pyramid.packed)
    stages["descriptors"] = lambda: describe(
        pyramid, strongest, False, templates, directions, descriptors
    )
    stages["whole"] = lambda: extractor.extract(image)
    return measure_in_turn(stages)


def measure_in_turn(stages: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median milliseconds of each stage over the rounds; a round runs all of them."""
    spent_ms: dict[str, list[float]] = {stage: [] for stage in stages}
    for _ in range(ROUNDS):
        for stage, run in stages.items():
            begin_s = time.thread_time()
            run()
            spent_ms[stage].append(1e3 * (time.thread_time() - begin_s))
    return {stage: float(np.median(ms)) for stage, ms in spent_ms.items()}
