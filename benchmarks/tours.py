"""Long tours of the virtual Kinect with revisited places: drift, loop closure, time and memory.

    python -m benchmarks tours FOLDER [--seconds 600] [--seeds 1 2 3] [--twins] [--plot FILE]

Each seed is another room and another tour. Frames are rendered on demand and not stored: that takes
0.11 s of processor time per frame, or a quarter of an hour on two idle cores for ten minutes.
FOLDER stores the arrays of each tour (stamps, truth, poses, milliseconds, memory) as .npz, and the
figures in results.json. Finished tours are not run again; remove FOLDER to measure again. With
--twins two corners of the room look the same.

"ATE" is that of all estimated poses, in millimeters; "optimized" that of the optimized poses at the
end. Gross errors are steps, and wrong loop closures are those, with an error above 5 cm or 3
degrees. CPU is that of the pose thread, milliseconds per frame in the first and in the last minute.
MB is the memory of the whole program in these minutes, including the virtual Kinect.
"""

import argparse
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmarks.harness import Json, ResultCache, Table, measure_cpu_ms, option, to_mm
from benchmarks.rendered_sequences import THREADS, make_frame, prefetch
from benchmarks.tracking import METHOD
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, inverse, poses_close
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import make_renderer
from drivers.synthetic.room import ROOM_HEIGHT_M
from drivers.synthetic.sensors import RenderedImages
from tests.resource_leaks import resident_memory_kb
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.odometry.warm_up import warm_up
from vo_service.slam.synchronous_loop_closure import (
    SynchronousLoopClosure,
    create_synchronous_loop_closure,
)
from vo_service.terminal import Terminal
from vo_service.tools.evaluation.evaluation import evaluate
from vo_service.tools.evaluation.metrics import (
    GROSS_ERROR_DEG,
    GROSS_ERROR_M,
    associate,
    best_alignment,
    count_gross_errors,
    position_errors_m,
    tracked_steps,
)
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate

MINUTE_S = 60.0
# Times and memory are plotted as mean and 99th percentile of windows of this length.
WINDOW_S = 10.0
LABELS = ("distance from the truth, mm", "CPU, ms per frame", "memory, MB")
# The arrays of a record that have a row for each frame.
ARRAYS = (
    *("stamp_s", "T_room_camera", "T_world_camera", "has_pose", "epoch"),
    *("cpu_ms", "loop_closure_ms", "memory_mb"),
)
TABLE = Table(
    *(30, "frames:8d", "cover %:9.1f", "epochs:8d", "gross:7d", "ATE:8.1f", "optimized:11.1f"),
    *("loop closures:15d", "wrong:7d", "CPU ms:13", "of loop closure:17", "MB:13"),
)


def make_tour_config(seed: int, seconds: float, aliased_corners: bool) -> SyntheticConfig:
    """Make the configuration of a tour with noise, depth quantization and rolling shutter.

    Motion blur and smooth edges are off, because they are slow to render.

    Args:
        seed: Seed of the room.
        seconds: Length, s.
        aliased_corners: Whether two corners of the room look the same.
    """
    config = SyntheticConfig(
        seed=seed,
        duration_s=seconds,
        motion=MotionKind.TOUR,
        twin_corners=aliased_corners,
        texel_m=0.003,
    )
    return replace(config, color=replace(config.color, exposure_s=0.0, smooth_edges=False))


def compute_true_poses(config: SyntheticConfig) -> Array:
    """True poses T_room_camera (N, 4, 4) of all frames."""
    times_s = np.arange(config.frame_count) / config.rate_hz
    return make_motion(config, ROOM_HEIGHT_M).poses(times_s)


def render_frames(config: SyntheticConfig) -> Iterator[RgbdFrame]:
    """Yield all frames in order; two threads render a few ahead."""
    renderer = make_renderer(config, THREADS)
    for seq, images in enumerate(prefetch(renderer.render, config.frame_count)):
        yield make_tour_frame(config, seq, images)


def make_tour_frame(config: SyntheticConfig, seq: int, images: RenderedImages) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images, with a stamp in microseconds.

    Args:
        config: The tour.
        seq: Number of the frame.
        images: Its color and depth.
    """
    return make_frame(config, seq, round(seq / config.rate_hz, 6), images)


@dataclass(frozen=True)
class LoopClosureRecord:
    """An accepted loop closure: T_keyframe_camera (4, 4) between two frames."""

    keyframe_stamp_s: float
    stamp_s: float
    T_keyframe_camera: Array


@dataclass(frozen=True)
class TourRecord:
    """Measurements of F frames, in order.

    Attributes:
        stamp_s: (F,).
        T_room_camera: (F, 4, 4) true poses.
        T_world_camera: (F, 4, 4) estimated poses.
        has_pose: (F,) whether the estimate is valid.
        epoch: (F,).
        cpu_ms: (F,) processor time of the thread for the pose.
        loop_closure_ms: (F,) processor time after that, for the map.
        memory_mb: (F,) memory of the process, including the virtual Kinect.
        optimized: The optimized poses at the end.
        loop_closures: All loop closures.
    """

    stamp_s: Array
    T_room_camera: Array
    T_world_camera: Array
    has_pose: NDArray[np.bool_]
    epoch: NDArray[np.int64]
    cpu_ms: Array
    loop_closure_ms: Array
    memory_mb: Array
    optimized: Trajectory
    loop_closures: Sequence[LoopClosureRecord]

    @property
    def trajectory(self) -> Trajectory:
        """Estimated trajectory of the frames with a pose."""
        return Trajectory(self.stamp_s[self.has_pose], self.T_world_camera[self.has_pose])

    @property
    def truth(self) -> Trajectory:
        """True trajectory of all frames."""
        return Trajectory(self.stamp_s, self.T_room_camera)

    def save(self, file: Path) -> None:
        """Save the arrays in a .npz file."""
        loops = self.loop_closures
        np.savez_compressed(
            file,
            optimized_s=self.optimized.stamps_s,
            T_optimized=self.optimized.T_world_camera,
            loop_stamps_s=[(loop.keyframe_stamp_s, loop.stamp_s) for loop in loops],
            T_keyframe_camera=[loop.T_keyframe_camera for loop in loops],
            **{name: getattr(self, name) for name in ARRAYS},
        )

    @classmethod
    def load(cls, file: Path) -> "TourRecord":
        """Load a file of `save`."""
        with np.load(file) as arrays:
            stamps_s, T = arrays["loop_stamps_s"].tolist(), arrays["T_keyframe_camera"]
            return cls(
                **{name: arrays[name] for name in ARRAYS},
                optimized=Trajectory(arrays["optimized_s"], arrays["T_optimized"]),
                loop_closures=[
                    LoopClosureRecord(keyframe_s, stamp_s, T_loop)
                    for (keyframe_s, stamp_s), T_loop in zip(stamps_s, T, strict=True)
                ],
            )


class TrajectoryRunner(Protocol):
    """Estimates the poses of frames, and the optimized trajectory at the end."""

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose of the next frame."""
        ...

    def update_map(self) -> None:
        """Do the map's work after the pose of a frame."""
        ...

    def optimized_trajectory(self) -> Trajectory:
        """Return the optimized poses after the last frame."""
        ...

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """Return all loop closures so far."""
        ...


class LoopClosureRunner:
    """An odometry with synchronous loop closure.

    Attributes:
        map: The map.
        last_update: The update of the last frame.
    """

    def __init__(self, method: str, loop_closure: SynchronousLoopClosure) -> None:
        """`loop_closure` may have a loaded map."""
        self.map = loop_closure
        self._odometry = loop_closure.wrap(METHODS[method](MethodConfig(), CpuStageTimer()))
        self._tracker = OdomFrame()
        self.last_update: OdometryUpdate | None = None

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """See `TrajectoryRunner`."""
        estimate = self._odometry.estimate(frame)
        self.last_update = self._tracker.update(
            StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0
        )
        return estimate

    def update_map(self) -> None:
        """See `TrajectoryRunner`."""
        if self.last_update is not None:
            self.map.on_update(self.last_update)

    def optimized_trajectory(self) -> Trajectory:
        """See `TrajectoryRunner`."""
        return self.map.trajectory

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """See `TrajectoryRunner`. Those of a culled keyframe belong to its neighbor."""
        database = self.map.loop_closer.database
        return [
            LoopClosureRecord(database[edge.a].stamp_s, database[edge.b].stamp_s, edge.T_a_b)
            for edge in self.map.loop_closer.graph.edges
            if edge.is_loop
        ]


def make_runner(method: str) -> TrajectoryRunner:
    """Make the runner of a method with loop closure."""
    return LoopClosureRunner(method, create_synchronous_loop_closure(MapConfig()))


@dataclass(frozen=True)
class TourResult:
    """The figures of one tour. None: could not be computed.

    Attributes:
        frames: Number of frames.
        coverage: Fraction of the frames with a pose.
        epochs: Epochs begun after the first.
        gross: Tracked steps with an error above 5 cm or 3 degrees.
        ate_m: ATE of the poses as they were estimated.
        ate_optimized_m: ATE of the optimized poses at the end.
        loop_closures: Number of loop closures.
        wrong_loop_closures: Those with an error above 5 cm or 3 degrees.
        cpu_ms: Mean time of a pose, in the first and in the last minute.
        loop_closure_ms: Mean time of the map's work per frame, likewise.
        memory_mb: Mean memory, likewise.
    """

    frames: int
    coverage: float
    epochs: int
    gross: int
    ate_m: float | None
    ate_optimized_m: float | None
    loop_closures: int
    wrong_loop_closures: int
    cpu_ms: tuple[float, float]
    loop_closure_ms: tuple[float, float]
    memory_mb: tuple[float, float]

    def format_row(self, name: str) -> str:
        """The line of the table."""
        return TABLE.row(
            name,
            *(self.frames, 100.0 * self.coverage, self.epochs, self.gross),
            *(to_mm(self.ate_m), to_mm(self.ate_optimized_m)),
            *(self.loop_closures, self.wrong_loop_closures),
            *("{:.2f} {:.2f}".format(*pair) for pair in (self.cpu_ms, self.loop_closure_ms)),
            "{:.0f} {:.0f}".format(*self.memory_mb),
        )


def run_tour(
    runner: TrajectoryRunner,
    frames: Iterable[RgbdFrame],
    T_room_camera: Array,
    progress: Callable[[int, int], None],
) -> TourRecord:
    """Run all frames without storing them.

    Args:
        runner: The method.
        frames: The frames.
        T_room_camera: Their true poses (N, 4, 4).
        progress: Called after each frame.
    """
    rows = []
    for frame in frames:
        estimate, cpu_ms = measure_cpu_ms(partial(runner.estimate_pose, frame))
        _, map_ms = measure_cpu_ms(runner.update_map)
        pose = (estimate.T_world_camera, estimate.ok, estimate.is_reset)
        memory_mb = resident_memory_kb(os.getpid()) / 1e3
        rows.append((frame.stamp_s, *pose, cpu_ms, map_ms, memory_mb))
        progress(len(rows), len(T_room_camera))
    stamp_s, T_world_camera, is_ok, is_reset, pose_ms, loop_closure_ms, used_mb = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    return TourRecord(
        stamp_s,
        T_room_camera[: len(rows)],
        T_world_camera,
        is_ok,
        np.cumsum(is_reset),
        pose_ms,
        loop_closure_ms,
        used_mb,
        runner.optimized_trajectory(),
        tuple(runner.loop_closures()),
    )


def summarize(record: TourRecord) -> TourResult:
    """Compute the figures of a tour."""
    wrong = [loop for loop in record.loop_closures if is_wrong_loop(loop, record)]
    return TourResult(
        frames=len(record.has_pose),
        coverage=float(record.has_pose.mean()),
        epochs=int(record.epoch[-1]),
        gross=_count_gross_errors(record),
        ate_m=_ate_m(record.trajectory, record.truth),
        ate_optimized_m=_ate_m(record.optimized, record.truth),
        loop_closures=len(record.loop_closures),
        wrong_loop_closures=len(wrong),
        cpu_ms=_first_and_last(record.cpu_ms, record.stamp_s),
        loop_closure_ms=_first_and_last(record.loop_closure_ms, record.stamp_s),
        memory_mb=_first_and_last(record.memory_mb, record.stamp_s),
    )


def is_wrong_loop(loop: LoopClosureRecord, record: TourRecord) -> bool:
    """Whether a loop closure has a gross error."""
    keyframe, camera = np.searchsorted(record.stamp_s, [loop.keyframe_stamp_s, loop.stamp_s])
    true = inverse(record.T_room_camera[keyframe]) @ record.T_room_camera[camera]
    return not poses_close(
        true, loop.T_keyframe_camera, GROSS_ERROR_M, math.radians(GROSS_ERROR_DEG)
    )


def _count_gross_errors(record: TourRecord) -> int:
    try:
        matched = associate(record.trajectory, record.truth)
    except InputError:
        return 0
    steps = tracked_steps(matched, record.trajectory.stamps_s, record.epoch[record.has_pose])
    return count_gross_errors(matched, steps)


def _ate_m(trajectory: Trajectory, truth: Trajectory) -> float | None:
    try:
        return evaluate(trajectory, truth).ate_rmse_m
    except InputError:
        return None


def _first_and_last(values: Array, stamps_s: Array) -> tuple[float, float]:
    """Mean values of the first and of the last minute."""
    first = values[stamps_s < stamps_s[0] + MINUTE_S]
    last = values[stamps_s > stamps_s[-1] - MINUTE_S]
    return float(first.mean()), float(last.mean())


def save_plot(records: Mapping[str, TourRecord], file: Path) -> None:
    """Plot all tours together. Raises InputError if one has too few poses."""
    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(LABELS), 1, sharex=True, figsize=(8, 8), layout="tight")
    for name, record in records.items():
        _draw(axes, name, record)
    for axis, label in zip(axes, LABELS, strict=True):
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(visible=True, alpha=0.3)
        axis.legend(loc="upper left", fontsize="small")
    axes[-1].set_xlabel("minutes")
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


def _draw(axes: list[Axes], name: str, record: TourRecord) -> None:
    for what, poses in (("estimated", record.trajectory), ("optimized", record.optimized)):
        stamps_s, errors_m = _errors(poses, record.truth)
        axes[0].plot(stamps_s / 60.0, 1e3 * errors_m, label=f"{name}, {what}", linewidth=1)
    parts = _windows(record)
    minutes = [(n + 0.5) * WINDOW_S / 60.0 for n in range(len(parts))]
    lines = (
        (axes[1], "poses, mean", [record.cpu_ms[part].mean() for part in parts]),
        (axes[1], "poses, 99 %", [np.percentile(record.cpu_ms[part], 99) for part in parts]),
        (axes[1], "loop closure, mean", [record.loop_closure_ms[part].mean() for part in parts]),
        (axes[2], "", [record.memory_mb[part].mean() for part in parts]),
    )
    for axis, what, values in lines:
        axis.plot(minutes, values, label=f"{name}, {what}".rstrip(", "), linewidth=1)


def _windows(record: TourRecord) -> list[NDArray[np.intp]]:
    """Indices of the frames of each window, in order."""
    window = ((record.stamp_s - record.stamp_s[0]) // WINDOW_S).astype(int)
    return [np.flatnonzero(window == each) for each in np.unique(window)]


def _errors(poses: Trajectory, truth: Trajectory) -> tuple[Array, Array]:
    """Stamps, and distances of the poses from the truth after the best alignment."""
    matched = associate(poses, truth)
    return matched.stamps_s, position_errors_m(matched, best_alignment(matched))


OPTIONS = (
    option("folder", type=Path, help="folder of the results"),
    option("--seconds", type=float, default=600.0, help="length of a tour"),
    option("--seeds", nargs="+", type=int, default=[1]),
    option("--twins", action="store_true", help="two corners look the same"),
    METHOD,
    option("--plot", type=Path, metavar="FILE", help="error, CPU and memory over time"),
)


def main(args: argparse.Namespace) -> None:
    """Run the tours without stored results, and print all."""
    cache, names = ResultCache(args.folder), list[str]()
    warm_up(args.method, lambda stage: None)
    print(TABLE.head)
    for seed in args.seeds:
        name = f"{'twins' if args.twins else 'tour'}-{args.seconds:g}s-{seed}-{args.method}"
        config = make_tour_config(seed, args.seconds, args.twins)
        file = args.folder / f"{name}.npz"
        result = cache.get_or_run(name, partial(_measure, args.method, config, file))
        print(TourResult(**result).format_row(name), flush=True)
        names.append(name)
    if args.plot:
        records = {name: TourRecord.load(args.folder / f"{name}.npz") for name in names}
        save_plot(records, args.plot)


def _measure(method: str, config: SyntheticConfig, file: Path) -> Json:
    terminal = Terminal()
    record = run_tour(
        make_runner(method),
        render_frames(config),
        compute_true_poses(config),
        terminal.progress_callback(f"{file.stem}: frame"),
    )
    record.save(file)
    terminal.clear()
    return asdict(summarize(record))
