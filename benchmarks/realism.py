"""Errors of plain SIFT and ORB odometries: how realistic the virtual Kinect's images are."""

import argparse
import itertools
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from benchmarks.features import FeatureMethod, FeatureSet, make_opencv_method, match
from benchmarks.harness import option
from benchmarks.tracking import open_frames_with_truth
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, fit_rigid_motion, transform_points
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import NO_DISTORTION, SyntheticConfig
from vo_service.odometry.ransac import find_best_hypothesis

CAMERA = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3)  # of the tracks of freiburg1
COUNT = 1000
RATIO = 0.8
RANSAC_ROUNDS = 200
RANSAC_SEEDS = 9  # one run is not enough: the median and the range are printed
INLIER_M = 0.03
MIN_PAIRS = 6

PosedFrame = tuple[RgbdFrame, Array]
PointPairs = tuple[Array, Array]


@option("track", type=Path, help="trajectory of a real hand, in TUM format")
@option("--start-s", type=float, default=0.1, help="start in the track, seconds (%(default)s)")
@option("--frames", type=int, default=360, help="number of frames (%(default)s)")
@option("--seed", type=int, default=1, help="seed of the room (%(default)s)")
@option("--folder", type=Path, help="a recording to compare with")
def measure_realism(args: argparse.Namespace) -> None:
    """Realism of the virtual Kinect: errors of simple pipelines along a real hand's track.

    TRACK is a TUM trajectory file. SIFT and ORB features are matched from frame to frame (ratio
    test, cross-check) and lifted to 3-D by the depth; RANSAC and SVD fit the motion. It prints the
    error of the trajectory (ATE RMSE after alignment: median and range over RANSAC seeds) for the
    default sensor faults, and without distortion. RECORDING, a rendered or recorded folder with
    exact ground truth, gives the figures to compare with.
    """
    if args.folder is not None:
        with open_frames_with_truth(args.folder) as (frames, truth):
            posed = ((frame, truth.pose_near(frame.stamp_s)) for frame in frames)
            report(args.folder.name, [(frame, T) for frame, T in posed if T is not None])
    config = SyntheticConfig(
        seed=args.seed,
        track=args.track,
        track_start_s=args.start_s,
        duration_s=args.frames / 30.0,
        camera=CAMERA,
    )
    report("all faults", render_frames(config))
    pinhole = replace(config.color, distortion=NO_DISTORTION)
    report("without distortion", render_frames(replace(config, color=pinhole)))


def render_frames(config: SyntheticConfig) -> list[PosedFrame]:
    """Render the frames of the virtual camera, each with its true pose T_world_camera."""
    with TemporaryDirectory() as rendered, SyntheticCamera(config, Path(rendered)) as camera:
        truth = camera.ground_truth
        assert truth is not None
        return list(zip(camera, truth.T_world_camera, strict=True))


def report(name: str, frames: list[PosedFrame]) -> None:
    """Print a line with the errors of both pipelines."""
    z = np.concatenate([frame.depth_m[frame.depth_m > 0][::101] for frame, _ in frames])
    holes = np.mean([np.mean(frame.depth_raw == 0) for frame, _ in frames])
    line = (
        f"{name:28} {len(frames):4} frames, median depth {np.median(z):.2f} m, {holes:4.0%} holes"
    )
    for kind, detector in (("SIFT", cv2.SIFT.create(COUNT)), ("ORB", cv2.ORB.create(COUNT))):
        errors_mm = [1e3 * error_m for error_m in _errors_m(frames, make_opencv_method(detector))]
        low, middle, high = min(errors_mm), np.median(errors_mm), max(errors_mm)
        line += f" | {kind} {middle:5.1f} ({low:.1f}-{high:.1f}) mm"
    print(line, flush=True)


def _errors_m(frames: Iterable[PosedFrame], method: FeatureMethod) -> list[float]:
    """ATE RMSE for several RANSAC seeds."""
    points = [_find_points(method, frame) for frame, _ in frames]
    pairs = [_match_points(*both) for both in itertools.pairwise(points)]
    true = np.array([T_world_camera[:3, 3] for _, T_world_camera in frames])
    return [_trajectory_error_m(pairs, true, seed) for seed in range(RANSAC_SEEDS)]


def _find_points(method: FeatureMethod, frame: RgbdFrame) -> tuple[FeatureSet, Array]:
    """Find features at pixels with depth, and their points (N, 3) in meters."""
    features, camera = method(frame.gray), frame.camera
    columns, rows = np.rint(features.position_px).astype(int).T
    z = frame.depth_m[rows, columns].astype(np.float64)
    x = (features.position_px[:, 0] - camera.cx) / camera.fx * z
    y = (features.position_px[:, 1] - camera.cy) / camera.fy * z
    return features.select(z > 0), np.stack([x, y, z], axis=1)[z > 0]


def _match_points(a: tuple[FeatureSet, Array], b: tuple[FeatureSet, Array]) -> PointPairs:
    """Return the points of mutual matches that pass the ratio test."""
    nearest = dict(match(b[0], a[0], np.inf).tolist())
    pairs = [(i, j) for i, j in match(a[0], b[0], RATIO).tolist() if nearest.get(j) == i]
    i, j = np.array(pairs, int).reshape(-1, 2).T
    return a[1][i], b[1][j]


def _trajectory_error_m(pairs: Iterable[PointPairs], true: Array, seed: int) -> float:
    """ATE RMSE of the chained steps; a failed step counts as no motion."""
    T = [np.eye(4)]
    for previous, current in pairs:
        step = _fit_step(current, previous, seed)
        T.append(T[-1] if step is None else T[-1] @ step)
    positions = np.array(T)[:, :3, 3]
    aligned = transform_points(_fit(positions, true), positions)
    return float(np.sqrt(np.mean(np.sum((aligned - true) ** 2, axis=1))))


def _fit_step(current: Array, previous: Array, seed: int) -> Array | None:
    """Estimate T_previous_current by RANSAC and SVD; None with too few pairs."""
    if len(current) < MIN_PAIRS:
        return None
    P, Q = np.ascontiguousarray(current.T), np.ascontiguousarray(previous.T)
    gate = np.full((2, len(current)), 1.0 / INLIER_M)
    T, _ = find_best_hypothesis(P, Q, gate, RANSAC_ROUNDS, np.uint32(seed))
    near = np.linalg.norm(transform_points(T, current) - previous, axis=1) < INLIER_M
    return _fit(current[near], previous[near]) if near.sum() >= MIN_PAIRS else None


def _fit(source: Array, target: Array) -> Array:
    return fit_rigid_motion(source, target, np.ones(len(source)))
