"""Long tours of the virtual Kinect with revisited places: drift, loop closure, time and memory.

Each seed is another room and another tour. Frames are rendered on demand and not stored: that takes
0.11 s of processor time per frame, or a quarter of an hour on two idle cores for ten minutes.
FOLDER stores the arrays of each tour (stamps, truth, poses, milliseconds, memory) as .npz. Finished
tours are not run again; remove FOLDER to measure again. With --twins two corners of the room look
the same.

"ATE" is that of all estimated poses, in millimeters; "optimized" that of the optimized poses at the
end. Gross errors are steps, and wrong loop closures are those, with an error above 5 cm or 3
degrees. CPU is that of the pose thread, milliseconds per frame in the first and in the last minute.
MB is the memory of the whole program in these minutes, including the virtual Kinect.
"""

import argparse
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, measure_cpu_ms, option
from benchmarks.plots import Line, save_panels
from benchmarks.processes import memory_mb
from benchmarks.rendered_sequences import THREADS, make_frame, prefetch
from benchmarks.tracking import METHOD, evaluate_poses, is_gross, match_steps, pose_error
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, Trajectory, inverse
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import make_renderer
from drivers.synthetic.room import ROOM_HEIGHT_M
from drivers.synthetic.sensors import RenderedImages
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
from vo_service.tools.evaluation.metrics import (
    associate,
    best_alignment,
    count_gross_errors,
    position_errors_m,
)
from vo_service.types.odometry_update import OdometryUpdate

MINUTE_S = 60.0
# Times and memory are plotted as mean and 99th percentile of windows of this length.
WINDOW_S = 10.0
LABELS = ("distance from the truth, mm", "CPU, ms per frame", "memory, MB")
TABLE = Table(
    *(30, "frames:8d", "cover %:9.1f", "epochs:8d", "gross:7d", "ATE:8.1mm", "optimized:11.1mm"),
    *("loop closures:15d", "wrong:7d", "CPU ms:13", "of loop closure:17", "MB:13"),
)


def make_tour_config(seed: int, seconds: float, aliased_corners: bool) -> SyntheticConfig:
    """Make the configuration of a tour with noise, depth quantization and rolling shutter.

    Motion blur and smooth edges are off, because they are slow to render.
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
    """Make frame `seq` of a camera of `config` from its images, with a stamp in microseconds."""
    return make_frame(config, seq, round(seq / config.rate_hz, 6), images)


@dataclass(frozen=True)
class TourRecord:
    """Measurements of F frames, in order, and what the map has at the end.

    Attributes:
        stamp_s: (F,).
        T_room_camera: (F, 4, 4) true poses.
        T_world_camera: (F, 4, 4) estimated poses.
        has_pose: (F,) whether the estimate is valid.
        epoch: (F,).
        cpu_ms: (F,) processor time of the thread for the pose.
        loop_closure_ms: (F,) processor time after that, for the map.
        memory_mb: (F,) memory of the process, including the virtual Kinect.
        optimized_s: (N,) stamps of the optimized poses.
        T_optimized: (N, 4, 4) optimized poses.
        loop_stamps_s: (L, 2) stamps of keyframe and camera of each loop closure.
        T_keyframe_camera: (L, 4, 4) the motion between them.
    """

    stamp_s: Array
    T_room_camera: Array
    T_world_camera: Array
    has_pose: NDArray[np.bool_]
    epoch: NDArray[np.int64]
    cpu_ms: Array
    loop_closure_ms: Array
    memory_mb: Array
    optimized_s: Array
    T_optimized: Array
    loop_stamps_s: Array
    T_keyframe_camera: Array

    @property
    def trajectory(self) -> Trajectory:
        """Estimated trajectory of the frames with a pose."""
        return Trajectory(self.stamp_s[self.has_pose], self.T_world_camera[self.has_pose])

    @property
    def optimized(self) -> Trajectory:
        """The optimized poses at the end."""
        return Trajectory(self.optimized_s, self.T_optimized)

    @property
    def truth(self) -> Trajectory:
        """True trajectory of all frames."""
        return Trajectory(self.stamp_s, self.T_room_camera)

    def save(self, file: Path) -> None:
        """Save the arrays in a .npz file."""
        part = file.with_suffix(".part.npz")
        np.savez_compressed(part, **vars(self))
        part.rename(file)

    @classmethod
    def load(cls, file: Path) -> "TourRecord":
        """Load a file of `save`."""
        with np.load(file) as arrays:
            return cls(**arrays)

    @property
    def wrong_loop_closures(self) -> int:
        """Number of loop closures with a gross error."""
        frames = np.searchsorted(self.stamp_s, self.loop_stamps_s)
        before, after = (self.T_room_camera[of_loop] for of_loop in frames.T)
        T_true = map(np.matmul, map(inverse, before), after)
        errors = map(pose_error, T_true, self.T_keyframe_camera)
        return sum(is_gross(*error) for error in errors)


class LoopClosureRunner:
    """An odometry with synchronous loop closure.

    Attributes:
        map: The map.
        cpu_ms: Processor time of the last frame: of its pose, and then of the map.
    """

    def __init__(self, method: str, loop_closure: SynchronousLoopClosure | None = None) -> None:
        """`loop_closure` may have a loaded map; by default it is new."""
        self.map = loop_closure or create_synchronous_loop_closure(MapConfig())
        self.cpu_ms = 0.0, 0.0
        self._odometry = self.map.wrap(METHODS[method](MethodConfig(), CpuStageTimer()))
        self._odom_frame = OdomFrame()

    def process(self, frame: RgbdFrame) -> OdometryUpdate:
        """Estimate the pose of the next frame, and then update the map."""
        update, pose_ms = measure_cpu_ms(partial(self._estimate, frame))
        _, map_ms = measure_cpu_ms(partial(self.map.on_update, update))
        self.cpu_ms = pose_ms, map_ms
        return update

    def _estimate(self, frame: RgbdFrame) -> OdometryUpdate:
        estimate = self._odometry.estimate(frame)
        return self._odom_frame.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0)

    @property
    def optimized(self) -> Trajectory:
        """The optimized poses after the last frame."""
        return self.map.trajectory

    def loop_closures(self) -> tuple[Array, Array]:
        """Return stamps (L, 2) of keyframe and camera, and T_keyframe_camera, of all loop closures.

        Those of a culled keyframe belong to its neighbor.
        """
        database = self.map.loop_closer.database
        loops = [edge for edge in self.map.loop_closer.graph.edges if edge.is_loop]
        stamps_s = [(database[edge.a].stamp_s, database[edge.b].stamp_s) for edge in loops]
        motions = np.array([edge.T_a_b for edge in loops])
        return np.array(stamps_s).reshape(-1, 2), motions.reshape(-1, 4, 4)


def run_tour(
    runner: LoopClosureRunner,
    frames: Iterable[RgbdFrame],
    T_room_camera: Array,
    progress: Callable[[int, int], None],
) -> TourRecord:
    """Run all frames without storing them."""
    rows = []
    for frame in frames:
        estimate = runner.process(frame).estimate
        pose = (estimate.T_world_camera, estimate.ok, estimate.is_reset)
        rows.append((frame.stamp_s, *pose, *runner.cpu_ms, memory_mb(os.getpid(), "VmRSS")))
        progress(len(rows), len(T_room_camera))
    stamp_s, T_world_camera, is_ok, is_reset, pose_ms, loop_closure_ms, used_mb = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    optimized = runner.optimized
    return TourRecord(
        stamp_s,
        T_room_camera[: len(rows)],
        T_world_camera,
        is_ok,
        np.cumsum(is_reset),
        pose_ms,
        loop_closure_ms,
        used_mb,
        optimized.stamps_s,
        optimized.T_world_camera,
        *runner.loop_closures(),
    )


def measure(record: TourRecord) -> tuple[float | str | None, ...]:
    """The cells of a tour's row; pairs are those of the first and of the last minute."""
    steps = match_steps(record.trajectory, record.truth, record.epoch[record.has_pose])
    poses = evaluate_poses(record.trajectory, record.truth)
    optimized = evaluate_poses(record.optimized, record.truth)
    return (
        len(record.has_pose),
        100.0 * float(record.has_pose.mean()),
        int(record.epoch[-1]),
        count_gross_errors(*steps) if steps else 0,
        None if poses is None else poses.ate_rmse_m,
        None if optimized is None else optimized.ate_rmse_m,
        len(record.loop_stamps_s),
        record.wrong_loop_closures,
        "{:.2f} {:.2f}".format(*_first_and_last(record.cpu_ms, record.stamp_s)),
        "{:.2f} {:.2f}".format(*_first_and_last(record.loop_closure_ms, record.stamp_s)),
        "{:.0f} {:.0f}".format(*_first_and_last(record.memory_mb, record.stamp_s)),
    )


def _first_and_last(values: Array, stamps_s: Array) -> tuple[float, float]:
    """Mean values of the first and of the last minute."""
    first = values[stamps_s < stamps_s[0] + MINUTE_S]
    last = values[stamps_s > stamps_s[-1] - MINUTE_S]
    return float(first.mean()), float(last.mean())


def save_plot(records: Mapping[str, TourRecord], file: Path) -> None:
    """Plot all tours together. Raises InputError if one has too few poses."""
    panels: dict[str, list[Line]] = {label: [] for label in LABELS}
    for name, record in records.items():
        for axis, lines in zip(LABELS, _lines(record), strict=True):
            panels[axis] += [(f"{name}, {what}".rstrip(", "), x, y) for what, x, y in lines]
    save_panels(file, "minutes", panels)


def _lines(record: TourRecord) -> tuple[list[Line], list[Line], list[Line]]:
    """The lines of a tour in each panel."""
    errors: list[Line] = []
    for what, poses in (("estimated", record.trajectory), ("optimized", record.optimized)):
        matched = associate(poses, record.truth)
        errors_m = position_errors_m(matched, best_alignment(matched))
        errors.append((what, matched.stamps_s / 60.0, 1e3 * errors_m))
    parts = _windows(record)
    minutes = [(n + 0.5) * WINDOW_S / 60.0 for n in range(len(parts))]
    times: list[Line] = [
        ("poses, mean", minutes, [record.cpu_ms[part].mean() for part in parts]),
        ("poses, 99 %", minutes, [np.percentile(record.cpu_ms[part], 99) for part in parts]),
        ("loop closure, mean", minutes, [record.loop_closure_ms[part].mean() for part in parts]),
    ]
    memory_mb = [record.memory_mb[part].mean() for part in parts]
    return errors, times, [("", minutes, memory_mb)]


def _windows(record: TourRecord) -> list[NDArray[np.intp]]:
    """Indices of the frames of each window, in order."""
    window = ((record.stamp_s - record.stamp_s[0]) // WINDOW_S).astype(int)
    return [np.flatnonzero(window == each) for each in np.unique(window)]


@option("folder", type=Path, help="folder of the results")
@option("--seconds", type=float, default=600.0, help="length of a tour")
@option("--seeds", nargs="+", type=int, default=[1])
@option("--twins", action="store_true", help="two corners look the same")
@METHOD
@option("--plot", type=Path, metavar="FILE", help="error, CPU and memory over time")
def main(args: argparse.Namespace) -> None:
    """Run the tours without stored results, and print all."""
    warm_up(args.method, lambda stage: None)
    args.folder.mkdir(parents=True, exist_ok=True)
    print(TABLE.head)
    records = {}
    for seed in args.seeds:
        name = f"{'twins' if args.twins else 'tour'}-{args.seconds:g}s-{seed}-{args.method}"
        config = make_tour_config(seed, args.seconds, args.twins)
        file = args.folder / f"{name}.npz"
        if not file.exists():
            record_tour(args.method, config, file)
        records[name] = TourRecord.load(file)
        print(TABLE.row(name, *measure(records[name])), flush=True)
    if args.plot:
        save_plot(records, args.plot)


def record_tour(method: str, config: SyntheticConfig, file: Path) -> None:
    """Run a tour, and save its arrays."""
    terminal = Terminal()
    record = run_tour(
        LoopClosureRunner(method),
        render_frames(config),
        compute_true_poses(config),
        partial(terminal.progress, f"{file.stem}: frame"),
    )
    record.save(file)
    terminal.clear()
