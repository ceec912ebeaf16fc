"""Tracking in hard cases of the virtual Kinect: difficult scenes, and standing still."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, Variants, option
from benchmarks.rendered_sequences import THREADS, make_frame, prefetch, render_all
from benchmarks.tracking import (
    METHOD,
    Accuracy,
    TrackedSequence,
    evaluate_accuracy,
    match_steps,
    open_frames_with_truth,
    track,
    track_with,
)
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, Trajectory, inverse, so3_log
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.renderer import NoiselessFrame, Renderer, make_renderer
from drivers.synthetic.sensors import gain_at
from vo_service.config import read_config
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.odometry.warm_up import warm_up
from vo_service.tools.evaluation.metrics import PosePairs, associate, count_gross_errors
from vo_service.types.odometry_update import TrackingState

SEQUENCES = Path(__file__).parents[1] / "config" / "sequences"
SLOW, STILL = "slow", "still"
SCENES = (
    *("object-8", "object-20", "person", "wall", "wall-drive", "dark", "covered", "gap"),
    *("fast-turn", "floor"),
    SLOW,
)
# Period of the exposure's hunting.
PERIOD_S = 20.0
# Size of the pool of noise; random offsets make all frames differ.
POOL_SIZE = 1 << 24
SCENE_TABLE = Table(
    *(12, "frames:8d", "degraded:10d", "lost:6d", "epochs:8d", "gross:9", "longest s:11.2f"),
    *("recovery s:12.2f", "ATE:8.1mm", "largest:9.1mm"),
)
STILL_TABLE = Table(
    *(7, "frames:8d", "lost:6d", "at most mm:12.3mm", "deg:8.4f", "RMS mm:9.3mm", "deg:8.4f"),
    *("drift mm:10.3mm", "deg:8.4f", "CPU ms:8.2f"),
)


def read_scene(name: str) -> SyntheticConfig:
    """Read the configuration of a scene or of `STILL`."""
    return replace(read_config(SEQUENCES / f"{name}.toml").synthetic, loop=False)


@dataclass(frozen=True)
class SceneResult(Accuracy):
    """Result of one sequence. None: not available.

    Attributes:
        gross: Steps between frames with a pose with an error above 5 cm or 3 degrees.
        gross_tracking: Those that end at a frame in state `tracking`.
        longest_gap_s: Longest time without a pose.
        recovery_s: Longest time from the end of a fault until a frame in state `tracking`;
            infinite if there is none.
    """

    gross: int = 0
    gross_tracking: int = 0
    longest_gap_s: float = 0.0
    recovery_s: float | None = None

    def format_row(self, name: str) -> str:
        """The line of the table."""
        return SCENE_TABLE.row(
            name,
            *(self.frames, self.degraded, self.lost, self.resets),
            f"{self.gross} ({self.gross_tracking})",
            *(self.longest_gap_s, self.recovery_s, self.ate_m, self.max_error_m),
        )


@option("folder", type=Path, help="folder of the sequences")
@METHOD
@option("--only", nargs="+", choices=SCENES, default=SCENES, metavar="CASE")
def measure_scenes(args: argparse.Namespace) -> None:
    """Tracking in difficult scenes: a table with one row for each.

    FOLDER stores the sequences of config/sequences, which are rendered the first time (twenty
    minutes of one core). A gross error is a step with an error above 5 cm or 3 degrees; in brackets
    are those at a frame in state `tracking`. "longest" is the longest time without a pose.
    "recovery" is the longest time from the end of a fault until a frame in state `tracking`. ATE
    and largest error are over all poses, in millimeters. "slow" creeps at a millimeter per second
    for a minute: its row has the tracked distance.
    """
    configs = {name: read_scene(name) for name in SCENES if name in args.only}
    folders = render_all(args.folder, configs)
    warm_up(args.method, lambda stage: None)
    print(f"{args.method}\n{SCENE_TABLE.head}")
    for name, config in configs.items():
        with open_frames_with_truth(folders[name]) as (frames, truth):
            tracked = track(args.method, frames)
        if name == SLOW:
            print(f"{name:12}{format_creep(tracked, truth)}", flush=True)
        else:
            print(evaluate_scene(tracked, truth, config).format_row(name), flush=True)


def evaluate_scene(
    tracked: TrackedSequence, truth: Trajectory, config: SyntheticConfig
) -> SceneResult:
    """Evaluate a sequence."""
    gross, gross_tracking = _count_gross_errors(tracked, truth)
    begin_s = tracked.stamps_s[0] if len(tracked.stamps_s) else 0.0
    ends_s = [begin_s + end_s for end_s in fault_end_times_s(config)]
    return SceneResult(
        **asdict(evaluate_accuracy(tracked, truth)),
        gross=gross,
        gross_tracking=gross_tracking,
        longest_gap_s=longest_gap_s(tracked.stamps_s, tracked.has_pose),
        recovery_s=max_recovery_s(tracked, ends_s),
    )


def fault_end_times_s(config: SyntheticConfig) -> list[float]:
    """When each fault and each moving object ends, in seconds from the first frame."""
    faults = [(fault.first + fault.count) / config.rate_hz for fault in config.faults]
    return [*faults, *(moving.end_s for moving in config.movers)]


def max_recovery_s(tracked: TrackedSequence, fault_ends_s: Sequence[float]) -> float | None:
    """Longest time from the end of a fault until a frame in state `tracking`; None if no fault."""
    is_tracking = np.array([state is TrackingState.TRACKING for state in tracked.states])
    tracked_s = tracked.stamps_s[is_tracking]
    waits_s = []
    for end_s in fault_ends_s:
        after_s = tracked_s[tracked_s >= end_s - 1e-6]
        waits_s.append(float(after_s[0] - end_s) if len(after_s) else np.inf)
    return max(0.0, *waits_s) if waits_s else None


def longest_gap_s(stamps_s: Array, has_pose: NDArray[np.bool_]) -> float:
    """Longest time from a frame with a pose to the next, beyond the median frame interval."""
    with_pose_s = stamps_s[has_pose]
    if not len(with_pose_s):
        return float("inf")
    marks_s = np.concatenate([stamps_s[:1], with_pose_s, stamps_s[-1:]])
    usual_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0
    return max(0.0, float(np.diff(marks_s).max()) - usual_s)


def _count_gross_errors(tracked: TrackedSequence, truth: Trajectory) -> tuple[int, int]:
    """Count gross errors: all, and those that end at a frame in state `tracking`."""
    matched_steps = match_steps(tracked.trajectory, truth, tracked.epochs[tracked.has_pose])
    if matched_steps is None:
        return 0, 0
    matched, steps = matched_steps
    frames = np.searchsorted(tracked.stamps_s, matched.stamps_s[steps.later])
    states = [tracked.states[frame] is TrackingState.TRACKING for frame in frames]
    is_tracking = np.array(states, np.bool_)
    tracking_steps = PosePairs(steps.earlier[is_tracking], steps.later[is_tracking])
    return count_gross_errors(matched, steps), count_gross_errors(matched, tracking_steps)


def format_creep(tracked: TrackedSequence, truth: Trajectory) -> str:
    """Format the tracked distance of a slow motion, projected onto the true one.

    Raises:
        InputError: There are too few poses.
    """
    matched = associate(tracked.trajectory, truth)
    true_m = _displacement_m(matched.T_truth_camera)
    length_m = float(np.linalg.norm(true_m))
    followed_m = float(_displacement_m(matched.T_world_camera) @ true_m) / length_m
    lost = int(np.count_nonzero(~tracked.has_pose))
    return (
        f"{len(tracked.stamps_s):8}{'':10}{lost:6}    {1e3 * followed_m:.2f} of "
        f"{1e3 * length_m:.2f} mm: {100.0 * followed_m / length_m:.1f} %"
    )


def _displacement_m(T_world_camera: Array) -> Array:
    """Displacement (3,) from the first pose to the last, in the axes of the first camera."""
    displacement_m: Array = (inverse(T_world_camera[0]) @ T_world_camera[-1])[:3, 3]
    return displacement_m


class PooledNoise(np.random.Generator):
    """Normal noise from random offsets in a pool that is drawn once; three times as fast."""

    def __init__(self, pool: NDArray[np.float32], seed: list[int]) -> None:
        super().__init__(np.random.PCG64(seed))
        self._pool = pool

    def standard_normal(  # type: ignore[override]
        self, size: tuple[int, ...], dtype: Any = np.float32
    ) -> NDArray[np.float32]:
        """As of any generator, but always float32 and read-only."""
        count = int(np.prod(size))
        start = int(self.integers(len(self._pool) - count))
        return self._pool[start : start + count].reshape(size)


@dataclass(frozen=True)
class StaticView:
    """The view of a stationary virtual Kinect, with fresh noise and exposure in each frame."""

    config: SyntheticConfig
    renderer: Renderer
    noiseless: NoiselessFrame
    pool: NDArray[np.float32]

    @classmethod
    def render(cls, config: SyntheticConfig) -> "StaticView":
        """Render the first frame of `config` without noise."""
        still = replace(config, motion=MotionKind.STILL, duration_s=PERIOD_S)
        renderer = make_renderer(still, THREADS)
        pool = np.random.default_rng([config.seed, 8]).standard_normal(POOL_SIZE, dtype=np.float32)
        pool.flags.writeable = False
        return cls(still, renderer, renderer.render_noiseless(0), pool)

    def frame(self, seq: int) -> RgbdFrame:
        """Make frame `seq`; its bytes are the same in every run."""
        config, stamp_s = self.config, seq / self.config.rate_hz
        sight = replace(self.noiseless, gain=gain_at(config.color, stamp_s, PERIOD_S))
        images = self.renderer.apply_sensor_noise(
            sight, PooledNoise(self.pool, [config.seed, 9, seq])
        )
        return make_frame(config, seq, stamp_s, images)

    def frames(self, count: int) -> Iterator[RgbdFrame]:
        """Yield the first `count` frames; a few are made ahead."""
        return prefetch(self.frame, count)


@option("--minutes", type=int, default=60, help="minutes of frames")
@METHOD
def measure_standing_still(args: argparse.Namespace) -> None:
    """Drift of a stationary camera's pose, by default over an hour of frames.

    The virtual Kinect of config/sequences/still.toml stands still, with rolling shutter, skew,
    hunting exposure and fresh noise in each frame. Each minute of frames prints a line: the frames
    so far and those without a pose; the distance from the first pose, at most and RMS; the distance
    of this minute's mean from that of the first; and the processor time of a frame. An hour of
    frames takes less than an hour of one core.
    """
    config = read_scene(STILL)
    warm_up(args.method, lambda stage: None)
    minute_frames = round(60 * config.rate_hz)
    print(STILL_TABLE.head, flush=True)
    frames = StaticView.render(config).frames(args.minutes * minute_frames)
    for minutes, cells in enumerate(measure_drift(args.method, frames, minute_frames), 1):
        print(STILL_TABLE.row(f"{minutes:7}", *cells), flush=True)


def measure_drift(
    method: str, frames: Iterator[RgbdFrame], frames_per_report: int
) -> Iterator[tuple[float, ...]]:
    """Track a camera that never moves; yield the cells of a row after each `frames_per_report`."""
    timer, odom_frame = CpuStageTimer(), OdomFrame()
    odometry = METHODS[method](MethodConfig(), timer)
    sizes, means, cpu_ms, count = np.empty((0, 2)), list[Array](), 0.0, 0
    T_first_world = np.eye(4)
    while True:
        tracked = track_with(odometry, timer, islice(frames, frames_per_report), odom_frame)
        if len(tracked.estimates) < frames_per_report:
            return
        count += frames_per_report
        cpu_ms += float(tracked.cpu_ms.sum())
        poses = tracked.trajectory.T_world_camera
        if not len(poses):
            continue
        T_first_world = T_first_world if means else inverse(poses[0])
        minute = np.array([_pose_twist(T_first_world @ T) for T in poses])
        means.append(minute.mean(axis=0))
        sizes = np.concatenate([sizes, _twist_sizes(minute)])
        rms, (drift,) = np.sqrt(np.mean(sizes**2, axis=0)), _twist_sizes(means[-1] - means[0])
        lost = count - len(sizes)
        yield (count, lost, *sizes.max(axis=0), *rms, *drift, cpu_ms / count)


def _pose_twist(T: Array) -> Array:
    """Twist (6,) of a small motion, meters and degrees."""
    return np.concatenate([T[:3, 3], np.degrees(so3_log(T[:3, :3]))])


def _twist_sizes(twists: Array) -> Array:
    """Sizes (N, 2) of twists (N, 6), meters and degrees."""
    sizes: Array = np.linalg.norm(twists.reshape(-1, 2, 3), axis=2)
    return sizes


VARIANTS: Variants = {
    "scenes": measure_scenes,
    "still": measure_standing_still,
}
