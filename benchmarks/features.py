"""SURF compared with SIFT and ORB: repeatability, matching and cost of the features.

    python -m benchmarks features                            # views of the virtual Kinect's room
    python -m benchmarks features recordings/desk photo.jpg  # frames of recordings, and pictures

Each image is rotated, zoomed, tilted, blurred, relit and made noisy by 34 known transforms;
distances are in pixels of the original. Repeatability: fraction of the features inside both images
that are repeated within 2 px at a scale within a factor of 1.5. Score: fraction of the same
features that are matched within 3 px (nearest descriptor, ratio test 0.8). Precision: fraction of
all matches that are correct. The columns of the transform groups count correct matches.

The scores follow Mikolajczyk and Schmid, "A Performance Evaluation of Local Descriptors" (PAMI 27,
2005), with points and scales instead of overlapping ellipses.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import sqrt
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, measure_cpu_ms, median, option
from drivers.core import InputError
from drivers.core.folders import cache_folder
from drivers.core.geometry import Array
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.folder import read_frame_pairs
from vo_service.odometry.features.extractor import FeatureExtractor, Features, SurfExtractor
from vo_service.tools.compare.baselines.frame_to_frame import MATCH_RATIO, OpenCvExtractor

SYNTHETIC = SyntheticConfig(duration_s=18.0, rate_hz=1 / 3)  # six views, far apart
TIMING_ROUNDS = 5
GROUPS = ("rotation", "scale", "both", "perspective", "blur", "light", "noise")
TABLE = Table(
    *(6, "features:10.0f", "repeat.:9.3f", "score:7.3f", "precision:11.3f", "correct:9.0f"),
    *(f"{group}:{len(group) + 2}.0f" for group in GROUPS),
    *("error px:10.2f", "CPU ms:8.1f", "us/feature:12.1f"),
)
Gray = NDArray[np.uint8]
Corners = list[tuple[float, float]]
Size = tuple[int, int]

# Blur of a camera's own optics, in its pixels (Lowe 2004, Section 3.3).
CAMERA_BLUR_PX = 0.5


@dataclass(frozen=True)
class ImageTransform:
    """One transform of an image, as by a camera motion or a change of the light.

    Attributes:
        group: Its group in the table.
        H: Homography (3, 3) from pixels of the original to pixels of the transformed image.
        zoom: Size of objects in the transformed image relative to the original.
        change_brightness: Change of the brightness after the warp.
    """

    group: str
    H: Array = field(default_factory=lambda: np.eye(3))
    zoom: float = 1.0
    change_brightness: Callable[[Gray], Gray] = np.copy

    def apply(self, image: Gray) -> Gray:
        """Transform an image; the result has the same size."""
        warped = image if np.array_equal(self.H, np.eye(3)) else _resample(image, self.H, self.zoom)
        return self.change_brightness(warped)


def all_transforms(size: Size) -> list[ImageTransform]:
    """Make the 34 transforms of the benchmark, of images of (width, height)."""
    rotations = [(float(angle), 1.0) for angle in (10, 20, 30, 45, 60, 90, 135, 180)]
    zooms = [(0.0, zoom) for zoom in (0.5, 0.63, 0.8, 1.25, 1.6, 2.0)]
    both = [(30.0, 0.7), (45.0, 1.4), (100.0, 0.8), (160.0, 1.6)]
    changes: list[tuple[str, Callable[[Gray], Gray]]] = [
        *(("blur", partial(blur, sigma)) for sigma in (1.0, 1.5, 2.0, 3.0)),
        *(("light", partial(_change_lighting, *light)) for light in LIGHTS),
        *(("noise", partial(add_noise, sigma)) for sigma in (5.0, 10.0, 15.0, 20.0)),
    ]
    return [
        *(
            ImageTransform(group, make_rotation(size, angle, zoom), zoom)
            for group, motions in (("rotation", rotations), ("scale", zooms), ("both", both))
            for angle, zoom in motions
        ),
        *(ImageTransform("perspective", make_perspective_tilt(size, *tilt)) for tilt in TILTS),
        *(ImageTransform(group, change_brightness=change) for group, change in changes),
    ]


# Share of the width and height by which the far side shrinks: left, right, top, bottom.
TILTS = ((0.1, 0, 0, 0), (0, 0.2, 0, 0), (0, 0, 0.15, 0), (0.1, 0, 0, 0.15))
# Gamma, contrast and offset.
LIGHTS = ((0.5, 1.0, 0.0), (2.0, 1.0, 0.0), (1.0, 0.5, 0.0), (1.0, 1.3, 20.0))


def make_rotation(size: Size, angle_deg: float, zoom: float = 1.0) -> Array:
    """Rotate about the center of the image and zoom in."""
    H, middle = np.eye(3), ((size[0] - 1) / 2, (size[1] - 1) / 2)
    H[:2] = cv2.getRotationMatrix2D(middle, angle_deg, zoom)
    return H


def make_perspective_tilt(
    size: Size, left: float, right: float, top: float, bottom: float
) -> Array:
    """Tilt the scene away from the camera: one side becomes shorter.

    The corners of a side move inwards by its share of the image's width and height.
    """
    (width, height), right_px, bottom_px = size, size[0] - 1.0, size[1] - 1.0
    corners: Corners = [(0, 0), (right_px, 0), (right_px, bottom_px), (0, bottom_px)]
    moved: Corners = [
        (width * (left + top), height * (top + left)),
        (right_px - width * (right + top), height * (top + right)),
        (right_px - width * (right + bottom), bottom_px - height * (bottom + right)),
        (width * (left + bottom), bottom_px - height * (bottom + left)),
    ]
    H = cv2.getPerspectiveTransform(np.array(corners, np.float32), np.array(moved, np.float32))
    return np.asarray(H, np.float64)


def blur(sigma_px: float, image: Gray) -> Gray:
    """Blur an image as if out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)


def _change_lighting(gamma: float, contrast: float, offset: float, image: Gray) -> Gray:
    """Change light and exposure; bright values are clipped."""
    levels = 255.0 * (np.arange(256) / 255.0) ** gamma
    table = np.clip(np.rint(contrast * levels + offset), 0, 255).astype(np.uint8)
    return table[image]


def add_noise(sigma: float, image: Gray) -> Gray:
    """Add sensor noise, the same in every run."""
    noise = np.random.default_rng(0).normal(0.0, sigma, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def _resample(image: Gray, H: Array, zoom: float) -> Gray:
    """Warp; where the image shrinks, first blur it like the camera's optics."""
    blur_px = CAMERA_BLUR_PX * np.sqrt(max(1.0 / zoom**2 - 1.0, 0.0))
    smooth = blur(float(blur_px), image) if blur_px > 0 else image
    # The border is replicated: there is no edge along it and no mirrored copy beyond it.
    warped = cv2.warpPerspective(
        smooth, H, size_of(image), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped, np.uint8)


COUNT = 1000
MAX_REPEAT_ERROR_PX = 2.0
MAX_CORRECT_ERROR_PX = 3.0
MAX_SCALE_RATIO = 1.5
# Extractor and ratio of the test, by name. ORB's distance is that of vectors of bits, the root of
# the number of different bits.
METHODS: Mapping[str, tuple[FeatureExtractor, float]] = {
    "SURF": (SurfExtractor(COUNT), MATCH_RATIO),
    "SIFT": (OpenCvExtractor(cv2.SIFT.create, COUNT), MATCH_RATIO),
    "ORB": (OpenCvExtractor(cv2.ORB.create, COUNT, binary=True), sqrt(MATCH_RATIO)),
}


def match(original: Features, changed: Features, ratio: float) -> NDArray[np.int64]:
    """Match descriptors by brute force and the ratio test (Lowe 2004, Section 7.1).

    Returns:
        Pairs (M, 2) of indices of nearest neighbors.
    """
    if len(original) == 0 or len(changed) < 2:
        return np.empty((0, 2), np.int64)
    # The squared distances of vectors of bits are exact.
    matcher, limit = cv2.BFMatcher(cv2.NORM_L2SQR), round(ratio**2, 6)
    two_nearest = matcher.knnMatch(original.descriptor, changed.descriptor, k=2)
    pairs = [(a.queryIdx, a.trainIdx) for a, b in two_nearest if a.distance < limit * b.distance]
    return np.array(pairs, np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class FeatureScore:
    """Scores of one image's features under one transform. Distances are pixels of the original.

    Attributes:
        max_repeatable: Features that are inside both images: the smaller count of the two.
        repeated: Features repeated within 2 px at a scale within a factor of 1.5.
        matches: Matches that pass the ratio test.
        errors_px: (correct,) distances of the matches within 3 px of their true position.
    """

    max_repeatable: int
    repeated: int
    matches: int
    errors_px: Array

    @property
    def correct(self) -> int:
        """Number of correct matches."""
        return len(self.errors_px)


def score_features(
    original: Features, changed: Features, ratio: float, H: Array, size: Size
) -> FeatureScore:
    """Compare the features of an image, (width, height), with those of its transformed version.

    `H` is the homography (3, 3) from pixels of the original to pixels of the transformed image.
    """
    position_px = original.position_px.astype(np.float64)
    seen_again = is_inside(transform_points(H, position_px), size)
    H_back = np.asarray(np.linalg.inv(H), np.float64)
    back_px = transform_points(H_back, changed.position_px.astype(np.float64))
    is_of_original = is_inside(back_px, size)
    back_scale = changed.scale_px / scale_at(H, back_px)
    repeated = _count_repeated(
        position_px[seen_again],
        original.scale_px[seen_again],
        back_px[is_of_original],
        back_scale[is_of_original],
    )
    pairs = match(original, changed, ratio)
    away_px = position_px[pairs[:, 0]] - back_px[pairs[:, 1]]
    errors_px = np.asarray(np.linalg.norm(away_px, axis=1), np.float64)
    return FeatureScore(
        max_repeatable=int(min(seen_again.sum(), is_of_original.sum())),
        repeated=repeated,
        matches=len(pairs),
        errors_px=errors_px[errors_px <= MAX_CORRECT_ERROR_PX],
    )


def transform_points(H: Array, points_px: Array) -> Array:
    """Transform pixels (N, 2) by a homography."""
    if len(points_px) == 0:
        return points_px
    return np.asarray(cv2.perspectiveTransform(points_px[None], H)[0], np.float64)


def scale_at(H: Array, points_px: Array) -> Array:
    """Local scale (N,) of a homography at pixels (N, 2): sqrt |det J|."""
    w = points_px @ H[2, :2] + H[2, 2]
    return np.asarray(np.sqrt(np.abs(np.linalg.det(H) / w**3)))


def is_inside(points_px: Array, size: Size) -> NDArray[np.bool_]:
    """Which pixels (N, 2) are inside an image of (width, height)."""
    return np.asarray(np.all((points_px >= 0) & (points_px <= np.array(size) - 1.0), axis=1))


def _count_repeated(a_px: Array, a_scale: NDArray[np.float32], b_px: Array, b_scale: Array) -> int:
    """Count features with a counterpart of similar position and scale; the smaller count of both.

    The assignment is not one to one: two features on the same spot both count.
    """
    if len(a_px) == 0 or len(b_px) == 0:
        return 0
    distance_px = np.linalg.norm(a_px[:, None] - b_px[None], axis=2)
    scale_step = np.abs(np.log(a_scale[:, None] / b_scale[None]))
    is_same = (distance_px <= MAX_REPEAT_ERROR_PX) & (scale_step < np.log(MAX_SCALE_RATIO))
    return int(min(is_same.any(axis=1).sum(), is_same.any(axis=0).sum()))


@option("source", nargs="*", type=Path, help="TUM folder or image (default: the virtual Kinect)")
@option("--frames", type=int, default=2, help="frames of each folder (2)")
def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    images = list(load_images(args.source, args.frames))
    rows = {}
    for name, method in METHODS.items():
        print(f"measuring {name} ...", file=sys.stderr)
        rows[name] = measure(*method, images)
    print(f"{len(images)} images, {len(all_transforms((2, 2)))} transforms of each")
    print(TABLE.head)
    print(*(TABLE.row(name, *cells) for name, cells in rows.items()), sep="\n")


def load_images(sources: Sequence[Path], frames: int) -> Iterator[Gray]:
    """Yield gray images of folders (`frames` each, evenly spread) and files.

    Without sources they are views of the virtual Kinect. Raises InputError if one cannot be read.
    """
    if not sources:
        with SyntheticCamera(SYNTHETIC, cache_folder() / "sequences") as camera:
            yield from (frame.gray for frame in camera)
    for source in sources:
        for file in sample_images(source, frames) if source.is_dir() else [source]:
            yield read_gray(file)


def read_gray(file: Path) -> Gray:
    """Read an image. Raises InputError if it cannot be read."""
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"{file}: not a readable image")
    return np.asarray(image, np.uint8)


def sample_images(folder: Path, count: int) -> list[Path]:
    """Color images of `count` frames of a folder, evenly spread from first to last."""
    pairs = read_frame_pairs(folder).pairs
    chosen = np.unique(np.linspace(0, len(pairs) - 1, max(count, 1)).round().astype(int))
    return [pairs[i].color.file for i in chosen]


def measure(extractor: FeatureExtractor, ratio: float, images: Sequence[Gray]) -> list[float]:
    """Measure a method on all transforms of all images; return the cells of its row.

    They are means over images and transforms; the error is the median of the correct matches. The
    number of features and the processor time are those of an original image, on one thread.
    """
    cpu_ms, features = np.mean([measure_cost(extractor, image) for image in images], axis=0)
    scores = [pair for image in images for pair in score_method(extractor, ratio, image)]
    every = [score for _, score in scores]
    correct = [[s.correct for kind, s in scores if kind == group] for group in GROUPS]
    return [
        float(features),
        mean([s.repeated / s.max_repeatable for s in every if s.max_repeatable]),
        mean([s.correct / s.max_repeatable for s in every if s.max_repeatable]),
        mean([s.correct / s.matches for s in every if s.matches]),
        *(mean(counts) for counts in ([s.correct for s in every], *correct)),
        median(np.concatenate([s.errors_px for s in every]).tolist()),
        *(float(cpu_ms), 1e3 * float(cpu_ms / features)),
    ]


def score_method(
    extractor: FeatureExtractor, ratio: float, image: Gray
) -> Iterator[tuple[str, FeatureScore]]:
    """Yield the group and the score of each transform of an image."""
    size, original = size_of(image), extractor.extract(image)
    for change in all_transforms(size):
        changed = extractor.extract(change.apply(image))
        yield change.group, score_features(original, changed, ratio, change.H, size)


def size_of(image: Gray) -> Size:
    """Width and height of an image."""
    return image.shape[1], image.shape[0]


def measure_cost(extractor: FeatureExtractor, image: Gray) -> tuple[float, int]:
    """Measure CPU milliseconds (median after a round that compiles) and the number of features."""
    features = len(extractor.extract(image))
    extract = partial(extractor.extract, image)
    spent_ms = [measure_cpu_ms(extract, time.process_time)[1] for _ in range(TIMING_ROUNDS)]
    return median(spent_ms), features


def mean(values: Sequence[float]) -> float:
    """Arithmetic mean; 0 for no values."""
    return float(np.mean(values)) if values else 0.0
