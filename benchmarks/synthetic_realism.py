"""Realism of the virtual Kinect: errors of simple pipelines along a real hand's track.

    python -m benchmarks synthetic_realism TRACK [--start-s 0.1] [--frames 360] [--folder RECORDING]

TRACK is a TUM trajectory file. SIFT and ORB features are matched from frame to frame (ratio test,
cross-check) and lifted to 3-D by the depth; RANSAC and SVD fit the motion. It prints the error of
the trajectory (ATE RMSE after alignment: median and range over RANSAC seeds) for the default sensor
faults, without distortion, with the lens of TUM's freiburg1, and without faults. RECORDING, a
rendered or recorded folder with exact ground truth, gives the figures to compare with.
"""

import argparse
import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, read_trajectory, transform_points
from drivers.synthetic import NO_DISTORTION, SyntheticConfig
from drivers.synthetic.camera import SyntheticCamera

FREIBURG1 = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3)
FREIBURG1_LENS = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
RATIO = 0.8
RANSAC_ROUNDS = 200
RANSAC_SEEDS = 9  # one run is not enough: the median and the range are printed
INLIER_M = 0.03


@dataclass(frozen=True)
class RealismView:
    """Input of a pipeline for one frame, and its true pose."""

    gray: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    camera: PinholeCamera
    T_world_camera: Array


@dataclass(frozen=True)
class PointFeatures:
    """Descriptors (N, D) of features with depth, and their points (N, 3) in meters."""

    descriptors: MatLike
    points_m: Array


def fit_rigid(source: Array, target: Array) -> Array:
    """Fit rigid motions (..., 4, 4) of points (..., N, 3) onto others by least squares.

    Arun, Huang, Blostein, Least-squares fitting of two 3-D point sets, PAMI 1987.
    """
    a, b = source.mean(axis=-2, keepdims=True), target.mean(axis=-2, keepdims=True)
    U, _, Vt = np.linalg.svd((source - a).swapaxes(-1, -2) @ (target - b))
    V, Ut = Vt.swapaxes(-1, -2).copy(), U.swapaxes(-1, -2)
    # A reflection is not a rigid motion: flip the least certain axis.
    V[..., :, 2] *= np.linalg.det(V @ Ut)[..., None]
    T = np.zeros((*source.shape[:-2], 4, 4))
    T[..., :3, :3] = R = V @ Ut
    T[..., :3, 3] = (b - a @ R.swapaxes(-1, -2))[..., 0, :]
    T[..., 3, 3] = 1.0
    return T


def find_features(detector: cv2.Feature2D, view: RealismView) -> PointFeatures:
    """Find features at pixels with depth."""
    keypoints, descriptors = detector.detectAndCompute(view.gray, np.ones_like(view.gray))
    if not keypoints:
        return PointFeatures(np.zeros((0, 1), np.uint8), np.zeros((0, 3)))
    pixels = np.array([keypoint.pt for keypoint in keypoints])
    columns, rows = np.rint(pixels).astype(int).T
    z = view.depth_m[rows, columns].astype(np.float64)
    x = (pixels[:, 0] - view.camera.cx) / view.camera.fx * z
    y = (pixels[:, 1] - view.camera.cy) / view.camera.fy * z
    return PointFeatures(descriptors[z > 0], np.stack([x, y, z], axis=1)[z > 0])


def match(matcher: cv2.BFMatcher, a: PointFeatures, b: PointFeatures) -> tuple[Array, Array]:
    """Return the points of mutual matches that pass the ratio test."""
    if min(len(a.points_m), len(b.points_m)) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    backward = {m.queryIdx: m.trainIdx for m in matcher.match(b.descriptors, a.descriptors)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(a.descriptors, b.descriptors, 2)
        if best.distance < RATIO * second.distance and backward[best.trainIdx] == best.queryIdx
    ]
    i, j = np.array(pairs, dtype=int).reshape(-1, 2).T
    return a.points_m[i], b.points_m[j]


def _estimate(current: Array, previous: Array, rng: np.random.Generator) -> Array | None:
    """Estimate T_previous_current by RANSAC and SVD; None with too few pairs."""
    if len(current) < 6:
        return None
    samples = rng.integers(0, len(current), (RANSAC_ROUNDS, 3))
    T = fit_rigid(current[samples], previous[samples])
    moved = current @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]
    near = np.linalg.norm(moved - previous, axis=2) < INLIER_M
    best = near[np.argmax(near.sum(axis=1))]
    return fit_rigid(current[best], previous[best]) if best.sum() >= 6 else None


def _trajectory_error_m(pairs: list[tuple[Array, Array]], true: Array, seed: int) -> float:
    """ATE RMSE of the chained steps; a failed step counts as no motion."""
    rng, T = np.random.default_rng(seed), np.eye(4)
    estimated = [T]
    for previous, current in pairs:
        step = _estimate(current, previous, rng)
        T = T if step is None else T @ step
        estimated.append(T)
    positions = np.array(estimated)[:, :3, 3]
    residual = transform_points(fit_rigid(positions, true), positions) - true
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def _errors_m(views: list[RealismView], detector: cv2.Feature2D, norm: int) -> list[float]:
    """ATE RMSE for several RANSAC seeds, sorted."""
    matcher = cv2.BFMatcher(norm)
    features = [find_features(detector, view) for view in views]
    pairs = [match(matcher, a, b) for a, b in itertools.pairwise(features)]
    true = np.array([view.T_world_camera[:3, 3] for view in views])
    return sorted(_trajectory_error_m(pairs, true, seed) for seed in range(RANSAC_SEEDS))


def render_views(config: SyntheticConfig) -> list[RealismView]:
    """Render the frames of the virtual camera."""
    views = []
    with SyntheticCamera(config) as camera:
        truth = camera.ground_truth
        assert truth is not None
        for T in truth.T_world_camera:
            frame = camera.read(1.0)
            views.append(RealismView(frame.gray, frame.depth_m, frame.camera, T))
    return views


def _load_views(folder: Path, camera: PinholeCamera, factor: float) -> list[RealismView]:
    """Load the frames of a folder whose ground truth has a pose for each frame."""
    truth = read_trajectory(folder / "groundtruth.txt")
    color, depth = sorted((folder / "rgb").iterdir()), sorted((folder / "depth").iterdir())
    views = []
    for T, c, d in zip(truth.T_world_camera, color, depth, strict=True):
        gray = cv2.imread(str(c), cv2.IMREAD_GRAYSCALE)
        raw = cv2.imread(str(d), cv2.IMREAD_UNCHANGED)
        if gray is None or raw is None:
            raise SystemExit(f"{c} or {d}: cannot read the image")
        depth_m = (raw / np.float32(factor)).astype(np.float32)
        views.append(RealismView(gray.astype(np.uint8), depth_m, camera, T))
    return views


def report(name: str, views: list[RealismView]) -> None:
    """Print a line with the errors of both pipelines."""
    z = np.concatenate([view.depth_m[view.depth_m > 0][::101] for view in views])
    holes = np.mean([np.mean(view.depth_m == 0) for view in views])
    line = f"{name:28} {len(views):4} frames, median depth {np.median(z):.2f} m, {holes:4.0%} holes"
    for kind, detector, norm in (
        ("SIFT", cv2.SIFT.create(1000), cv2.NORM_L2),
        ("ORB", cv2.ORB.create(1000), cv2.NORM_HAMMING),
    ):
        low, *middle, high = (1e3 * error for error in _errors_m(views, detector, norm))
        line += f" | {kind} {np.median([low, *middle, high]):5.1f} ({low:.1f}-{high:.1f}) mm"
    print(line, flush=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("track", type=Path, help="trajectory of a real hand, in TUM format")
    parser.add_argument(
        "--start-s", type=float, default=0.1, help="start in the track, seconds (%(default)s)"
    )
    parser.add_argument("--frames", type=int, default=360, help="number of frames (%(default)s)")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[1], help="seeds of the rooms (%(default)s)"
    )
    parser.add_argument("--folder", type=Path, help="a recording to compare with")
    parser.add_argument(
        "--only", nargs="+", default=["default", "pinhole", "freiburg1", "ideal"],
        help="sensors: all faults, without lens, with another lens, no faults (%(default)s)",
    )  # fmt: skip


def main(args: argparse.Namespace) -> None:
    """Run the selected variants."""
    if args.folder is not None:
        report(args.folder.name, _load_views(args.folder, FREIBURG1, 5000.0))
    driven = {
        "track": args.track,
        "track_start_s": args.start_s,
        "duration_s": args.frames / 30.0,
        "camera": FREIBURG1,
    }
    for seed in args.seeds:
        default = replace(SyntheticConfig(), seed=seed, **driven)
        ideal = replace(SyntheticConfig.ideal(), seed=seed, **driven)
        variants = {
            "default": default,
            "pinhole": replace(default, color=replace(default.color, distortion=NO_DISTORTION)),
            "freiburg1": replace(default, color=replace(default.color, distortion=FREIBURG1_LENS)),
            "ideal": ideal,
        }
        for name in args.only:
            report(f"seed {seed} {name}", render_views(variants[name]))
