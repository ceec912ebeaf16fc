"""Rendered sequences of the virtual Kinect along recorded hand motions, and their realism.

python -m benchmarks rendered_sequences render TRACKS OUTPUT [--seeds 11 12] [--timing ideal]
python -m benchmarks rendered_sequences realism TRACK [--folder RECORDING]
"""

import argparse
import itertools
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from benchmarks.features import read_gray
from benchmarks.harness import PROCESSES, Variants, option
from benchmarks.tracking import read_all_frames
from drivers.camera import PinholeCamera, RgbdCamera, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, read_trajectory, transform_points
from drivers.recording.frame_recorder import FrameRecorder
from drivers.synthetic.camera import SyntheticCamera, make_synthetic_camera
from drivers.synthetic.config import NO_DISTORTION, ShutterTiming, SyntheticConfig
from drivers.synthetic.sensors import RenderedImages
from drivers.tum.writer import TumFolder

THREADS = 2
PREFETCH_COUNT = 6
T = TypeVar("T")
# The configuration of a folder; a folder without this file is incomplete or not ours.
CONFIG_RECORD = "synthetic.txt"


def make_frame(
    config: SyntheticConfig, seq: int, stamp_s: float, images: RenderedImages
) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images; it arrives at its stamp.

    Args:
        config: The virtual Kinect.
        seq: Number of the frame.
        stamp_s: Its stamp, s.
        images: Its color and depth.
    """
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=images.color_bgr,
        depth_raw=images.depth_raw,
        depth_factor=config.depth_factor,
        camera=config.camera,
        skew_s=config.timing.skew_s,
        readout_s=config.timing.readout_s,
    )


def prefetch(make: Callable[[int], T], count: int) -> Iterator[T]:
    """Yield `make` of 0 to `count` - 1 in order; threads make the next few ahead."""
    with ThreadPoolExecutor(THREADS) as pool:
        made: deque[Future[T]] = deque()
        try:
            for number in range(count):
                made.append(pool.submit(make, number))
                if len(made) > PREFETCH_COUNT:
                    yield made.popleft().result()
            while made:
                yield made.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def render_all(
    sequences: Mapping[Path, SyntheticConfig], print_line: Callable[[str], None], processes: int
) -> None:
    """Render missing sequences and those of another configuration.

    An interrupted sequence is rendered again the next time.

    Args:
        sequences: The configuration of each folder.
        print_line: Prints progress.
        processes: Rendering processes.

    Raises:
        InputError: A folder has other contents, or a track cannot be used.
        UserFacingError: The disk is full.
    """
    missing = {
        folder: config for folder, config in sequences.items() if not is_complete(folder, config)
    }
    if not missing:
        return
    spawn = get_context("spawn")
    with ProcessPoolExecutor(
        processes, spawn, initializer=cv2.setNumThreads, initargs=(1,)
    ) as pool:
        futures = {
            pool.submit(render, folder, config): folder for folder, config in missing.items()
        }
        try:
            for count, future in enumerate(as_completed(futures), 1):
                future.result()
                print_line(f"rendered {count} of {len(missing)}: {futures[future]}")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def is_complete(folder: Path, config: SyntheticConfig) -> bool:
    """Whether a folder has the complete sequence of this configuration."""
    record = folder / CONFIG_RECORD
    return record.is_file() and record.read_text() == f"{config}\n"


def render(folder: Path, config: SyntheticConfig) -> None:
    """Render one sequence. Raises as `render_all`."""
    if folder.exists():
        if not (folder / CONFIG_RECORD).is_file():
            raise InputError(f"{folder}: was not written by this program; name another folder")
        shutil.rmtree(folder)
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    once = replace(config, loop=False)
    with (
        TemporaryDirectory() as rendered,
        make_synthetic_camera(once, Path(rendered), threads=1) as camera,
    ):
        _write(camera, part)
    (part / CONFIG_RECORD).write_text(f"{config}\n")
    part.rename(folder)


def _write(camera: RgbdCamera, folder: Path) -> None:
    with FrameRecorder(TumFolder(folder, ground_truth=camera.ground_truth)) as writer:
        for frame in read_all_frames(camera):
            writer.write(frame)


TRACK_SUFFIX = "-groundtruth.txt"
SEEDS = (11, 12, 13)
TIMINGS = {
    "ideal": ShutterTiming(0.0, 0.0),
    "rolling--12": ShutterTiming(0.020, -0.012),
    "rolling-0": ShutterTiming(0.020, 0.0),
    "rolling-12": ShutterTiming(0.020, 0.012),
}
# From there on freiburg1's xyz, rpy and desk all move fast.
START_S, DURATION_S = 12.0, 10.0


RENDER_OPTIONS = (
    option("tracks", type=Path, help="folder of trajectories"),
    option("output", type=Path, help="folder of the sequences"),
    option("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms"),
    option("--timing", nargs="+", choices=TIMINGS, default=list(TIMINGS)),
    option("--start", type=float, default=START_S, help="start in the track, seconds"),
    option(
        "--seconds",
        type=float,
        default=DURATION_S,
        help="duration of each, if the track is long enough",
    ),
    PROCESSES,
)


def render_tracks(args: argparse.Namespace) -> None:
    """Render virtual rooms along recorded hand motions, as TUM folders with exact ground truth.

    TRACKS is a folder of trajectories in TUM format, NAME-groundtruth.txt, such as those of the TUM
    RGB-D benchmark. Each becomes OUTPUT/NAME-roomSEED-TIMING, with a room for each seed. "ideal" is
    a global shutter; "rolling-12" has a readout of 20 ms and depth 12 ms after color. Otherwise the
    sensor is that of a Kinect. Complete sequences are not rendered again.
    """
    begin_s = time.monotonic()
    configs = make_configs(args.tracks, args.seeds, args.timing, args.start, args.seconds)
    sequences = {args.output / name: config for name, config in configs.items()}
    args.output.mkdir(parents=True, exist_ok=True)
    render_all(sequences, print, args.processes)
    print(f"{len(sequences)} sequences in {args.output}, after {time.monotonic() - begin_s:.0f} s")


def make_configs(
    tracks: Path,
    seeds: Sequence[int],
    timings: Sequence[str],
    start_s: float = START_S,
    duration_s: float = DURATION_S,
) -> dict[str, SyntheticConfig]:
    """Make the configurations by name: `duration_s` of each track, or less if it is shorter.

    Args:
        tracks: Folder of the trajectories.
        seeds: Seeds of the rooms.
        timings: Names of the timings.
        start_s: Start in each track, s.
        duration_s: Length, s.

    Raises:
        InputError: There are no tracks, one is broken, or one ends before `start_s`.
    """
    files = sorted(tracks.glob(f"*{TRACK_SUFFIX}"))
    if not files:
        raise InputError(f"{tracks}: has no *{TRACK_SUFFIX}; name a folder of TUM trajectories")
    return {
        f"{file.name.removesuffix(TRACK_SUFFIX)}-room{seed}-{timing}": SyntheticConfig(
            seed=seed,
            track=file.resolve(),
            track_start_s=start_s,
            duration_s=min(duration_s, _remaining_s(file, start_s)),
            timing=TIMINGS[timing],
        )
        for file in files
        for seed in seeds
        for timing in timings
    }


def _remaining_s(track: Path, start_s: float) -> float:
    stamps_s = read_trajectory(track).stamps_s
    length_s = float(stamps_s[-1] - stamps_s[0])
    if length_s <= start_s:
        raise InputError(f"{track}: ends after {length_s:g} s; start earlier than at {start_s:g} s")
    return length_s - start_s


FREIBURG1 = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3)
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
    with TemporaryDirectory() as rendered, SyntheticCamera(config, Path(rendered)) as camera:
        truth = camera.ground_truth
        assert truth is not None
        for T, frame in zip(truth.T_world_camera, camera, strict=True):
            views.append(RealismView(frame.gray, frame.depth_m, frame.camera, T))
    return views


def _load_views(folder: Path, camera: PinholeCamera, factor: float) -> list[RealismView]:
    """Load the frames of a folder whose ground truth has a pose for each frame."""
    truth = read_trajectory(folder / "groundtruth.txt")
    color, depth = sorted((folder / "rgb").iterdir()), sorted((folder / "depth").iterdir())
    views = []
    for T, c, d in zip(truth.T_world_camera, color, depth, strict=True):
        raw = cv2.imread(str(d), cv2.IMREAD_UNCHANGED)
        if raw is None:
            raise InputError(f"{d}: not a readable image")
        depth_m = (raw / np.float32(factor)).astype(np.float32)
        views.append(RealismView(read_gray(c), depth_m, camera, T))
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


REALISM_OPTIONS = (
    option("track", type=Path, help="trajectory of a real hand, in TUM format"),
    option("--start-s", type=float, default=0.1, help="start in the track, seconds (%(default)s)"),
    option("--frames", type=int, default=360, help="number of frames (%(default)s)"),
    option("--seed", type=int, default=1, help="seed of the room (%(default)s)"),
    option("--folder", type=Path, help="a recording to compare with"),
)


def measure_realism(args: argparse.Namespace) -> None:
    """Realism of the virtual Kinect: errors of simple pipelines along a real hand's track.

    TRACK is a TUM trajectory file. SIFT and ORB features are matched from frame to frame (ratio
    test, cross-check) and lifted to 3-D by the depth; RANSAC and SVD fit the motion. It prints the
    error of the trajectory (ATE RMSE after alignment: median and range over RANSAC seeds) for the
    default sensor faults, and without distortion. RECORDING, a rendered or recorded folder with
    exact ground truth, gives the figures to compare with.
    """
    if args.folder is not None:
        report(args.folder.name, _load_views(args.folder, FREIBURG1, 5000.0))
    config = SyntheticConfig(
        seed=args.seed,
        track=args.track,
        track_start_s=args.start_s,
        duration_s=args.frames / 30.0,
        camera=FREIBURG1,
    )
    report("all faults", render_views(config))
    pinhole = replace(config.color, distortion=NO_DISTORTION)
    report("without distortion", render_views(replace(config, color=pinhole)))


VARIANTS: Variants = {
    "render": (RENDER_OPTIONS, render_tracks),
    "realism": (REALISM_OPTIONS, measure_realism),
}
