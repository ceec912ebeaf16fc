"""Trains the VLAD vocabulary of place recognition on recordings in TUM format.

    python -m benchmarks train_vlad FOLDER...

It writes vo_service/slam/vlad_vocabulary.npy: the integer centers of k-means
clusters of SURF descriptors. The same folders give the same vocabulary. Measure place recognition
on other recordings than these.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tracking import read_all_frames
from drivers.camera import PlaybackMode
from drivers.recording_camera import RecordingCamera
from vo_service import slam
from vo_service.odometry.surf import SurfExtractor

OUTPUT = Path(slam.__file__).with_name("vlad_vocabulary.npy")
CLUSTERS, FEATURES_PER_IMAGE, FRAME_STRIDE = 32, 500, 30
# k-means: most iterations, and number of attempts.
MAX_ITERATIONS, ATTEMPTS = 100, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folders", nargs="+", type=Path, help="training recordings")
    parser.add_argument("--count", type=int, default=CLUSTERS, help="number of visual words")
    parser.add_argument("--output", type=Path, default=OUTPUT)


def main(args: argparse.Namespace) -> None:
    """Train the vocabulary and write it."""
    descriptors = np.concatenate([d for f in args.folders for d in extract_descriptors(f)])
    np.save(args.output, fit_centers(descriptors, args.count))
    print(f"{args.count} visual words of {len(descriptors)} features in {args.output}")


def extract_descriptors(folder: Path) -> Iterator[NDArray[np.float32]]:
    """Yield the SURF descriptors (N, 64) of evenly spaced frames of a recording."""
    extractor = SurfExtractor(FEATURES_PER_IMAGE)
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        for frame in read_all_frames(camera):
            if frame.seq % FRAME_STRIDE == 0:
                yield extractor.extract(frame.gray).descriptor


def fit_centers(descriptors: NDArray[np.float32], count: int) -> NDArray[np.int8]:
    """Cluster descriptors; returns centers (count, 64), sorted by their first component."""
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, 0.01)
    _, _, centers = cv2.kmeans(
        descriptors, count, np.empty(0), criteria, ATTEMPTS, cv2.KMEANS_PP_CENTERS
    )
    whole = np.clip(np.rint(centers), -127, 127).astype(np.int8)
    return whole[np.lexsort(whole.T[::-1])]
