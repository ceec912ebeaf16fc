"""Errors of plain SIFT and ORB odometries: how realistic the virtual Kinect's images are."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np

from benchmarks.features import METHODS
from benchmarks.harness import option
from benchmarks.tracking import open_frames_with_truth, render_with_truth
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, Trajectory, fit_rigid_motion, transform_points
from drivers.synthetic.config import NO_DISTORTION, SyntheticConfig
from vo_service.odometry.features.extractor import FeatureExtractor, Features
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.ransac import find_best_hypothesis
from vo_service.tools.evaluation.evaluation import evaluate

CAMERA = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3)  # of the tracks of freiburg1
RANSAC_ROUNDS = 200
RANSAC_SEEDS = 9  # one run is not enough: the median and the range are printed
INLIER_M = 0.03
MIN_PAIRS = 6
START_S = 0.1

PosedFrame = tuple[RgbdFrame, Array]


@option("track", type=Path, help="trajectory of a real hand, in TUM format")
@option("--frames", type=int, default=360, help="number of frames (%(default)s)")
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
        track=args.track,
        track_start_s=START_S,
        duration_s=args.frames / 30.0,
        camera=CAMERA,
    )
    report("all faults", list(render_with_truth(config)))
    pinhole = replace(config.color, distortion=NO_DISTORTION)
    without = replace(config, color=pinhole)
    report("without distortion", list(render_with_truth(without)))


def report(name: str, frames: list[PosedFrame]) -> None:
    """Print a line with the errors of both pipelines."""
    z = np.concatenate([frame.depth_m[frame.depth_m > 0][::101] for frame, _ in frames])
    holes = np.mean([np.mean(frame.depth_raw == 0) for frame, _ in frames])
    line = (
        f"{name:28} {len(frames):4} frames, median depth {np.median(z):.2f} m, {holes:4.0%} holes"
    )
    for kind in ("SIFT", "ORB"):
        errors_mm = [1e3 * error_m for error_m in _errors_m(frames, *METHODS[kind])]
        low, middle, high = min(errors_mm), np.median(errors_mm), max(errors_mm)
        line += f" | {kind} {middle:5.1f} ({low:.1f}-{high:.1f}) mm"
    print(line, flush=True)


def _errors_m(
    frames: Sequence[PosedFrame], extractor: FeatureExtractor, ratio: float
) -> list[float]:
    """ATE RMSE for several RANSAC seeds."""
    views = [_find_points(extractor, frame) for frame, _ in frames]
    pairs = [_match_points(*both, ratio) for both in pairwise(views)]
    stamps_s = np.array([frame.stamp_s for frame, _ in frames])
    truth = Trajectory(stamps_s, np.array([T_world_camera for _, T_world_camera in frames]))
    errors_m = []
    for seed in range(RANSAC_SEEDS):
        steps = (_fit_step(*each, seed) for each in pairs)
        poses = np.array(list(accumulate(steps, np.matmul, initial=np.eye(4))))
        errors_m.append(evaluate(Trajectory(stamps_s, poses), truth).ate_rmse_m)
    return errors_m


def _find_points(extractor: FeatureExtractor, frame: RgbdFrame) -> tuple[Features, Array]:
    """Find features at pixels with depth, and their points (N, 3) in meters."""
    features, camera = extractor.extract(frame.gray), frame.camera
    columns, rows = np.rint(features.position_px).astype(int).T
    z = frame.depth_m[rows, columns].astype(np.float64)
    x = (features.position_px[:, 0] - camera.cx) / camera.fx * z
    y = (features.position_px[:, 1] - camera.cy) / camera.fy * z
    points_m = np.stack([x, y, z], axis=1)[z > 0]
    return Features(*(column[z > 0] for column in vars(features).values())), points_m


def _match_points(
    earlier: tuple[Features, Array], later: tuple[Features, Array], ratio: float
) -> tuple[Array, Array]:
    """Return the points of both views whose features match."""
    i, j = match_features(earlier[0], later[0], ratio).T
    return earlier[1][i], later[1][j]


def _fit_step(previous: Array, current: Array, seed: int) -> Array:
    """Estimate T_previous_current by RANSAC and SVD; no motion with too few pairs."""
    if len(current) < MIN_PAIRS:
        return np.eye(4)
    P, Q = np.ascontiguousarray(current.T), np.ascontiguousarray(previous.T)
    gate = np.full((2, len(current)), 1.0 / INLIER_M)
    T, _ = find_best_hypothesis(P, Q, gate, RANSAC_ROUNDS, np.uint32(seed))
    near = np.linalg.norm(transform_points(T, current) - previous, axis=1) < INLIER_M
    if near.sum() < MIN_PAIRS:
        return np.eye(4)
    return fit_rigid_motion(current[near], previous[near], np.ones(near.sum()))
