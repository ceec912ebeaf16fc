"""Runs along tours, with or without loop closure: the runners, the record and its plot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, Trajectory
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry import METHODS, CpuStageTimer, MethodConfig
from vo_service.slam.synchronous_loop_closure import (
    SynchronousLoopClosure,
    create_synchronous_loop_closure,
)
from vo_service.tools.evaluation.metrics import associate, best_alignment, position_errors_m
from vo_service.types import Estimate, OdometryUpdate

# Times and memory are plotted as mean and 99th percentile of windows of this length.
WINDOW_S = 10.0
LABELS = ("distance from the truth, mm", "CPU, ms per frame", "memory, MB")


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
        T_place_camera = [loop.T_keyframe_camera for loop in self.loop_closures]
        np.savez_compressed(
            file,
            stamp_s=self.stamp_s,
            T_room_camera=self.T_room_camera,
            T_world_camera=self.T_world_camera,
            ok=self.has_pose,
            epoch=self.epoch,
            cpu_ms=self.cpu_ms,
            loops_ms=self.loop_closure_ms,
            memory_mb=self.memory_mb,
            corrected_stamp_s=self.optimized.stamps_s,
            corrected_T_world_camera=self.optimized.T_world_camera,
            loop_place_stamp_s=[loop.keyframe_stamp_s for loop in self.loop_closures],
            loop_stamp_s=[loop.stamp_s for loop in self.loop_closures],
            loop_T_place_camera=np.reshape(T_place_camera, (-1, 4, 4)),
        )

    @classmethod
    def load(cls, file: Path) -> "TourRecord":
        """Load a file of `save`."""
        with np.load(file) as arrays:
            loops = zip(
                arrays["loop_place_stamp_s"].tolist(),
                arrays["loop_stamp_s"].tolist(),
                arrays["loop_T_place_camera"],
                strict=True,
            )
            return cls(
                stamp_s=arrays["stamp_s"],
                T_room_camera=arrays["T_room_camera"],
                T_world_camera=arrays["T_world_camera"],
                has_pose=arrays["ok"],
                epoch=arrays["epoch"],
                cpu_ms=arrays["cpu_ms"],
                loop_closure_ms=arrays["loops_ms"],
                memory_mb=arrays["memory_mb"],
                optimized=Trajectory(
                    arrays["corrected_stamp_s"], arrays["corrected_T_world_camera"]
                ),
                loop_closures=[LoopClosureRecord(*loop) for loop in loops],
            )


class TrajectoryRunner(Protocol):
    """Estimates the poses of frames, and the optimized trajectory at the end."""

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose of the next frame."""
        ...

    def update_map(self) -> None:
        """Do the map's work after the pose of a frame."""
        ...

    def optimized_trajectory(self, trajectory: Trajectory) -> Trajectory:
        """Return the optimized poses after the last frame; `trajectory` has the estimated ones."""
        ...

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """Return all loop closures so far."""
        ...


class OdometryRunner:
    """Only the odometry, without loop closure and optimization."""

    def __init__(self, method: str) -> None:
        self._odometry = METHODS[method](MethodConfig(), CpuStageTimer())

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """See `TrajectoryRunner`."""
        return self._odometry.estimate(frame)

    def update_map(self) -> None:
        """See `TrajectoryRunner`."""

    def optimized_trajectory(self, trajectory: Trajectory) -> Trajectory:
        """See `TrajectoryRunner`."""
        return trajectory

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """See `TrajectoryRunner`."""
        return ()


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

    def optimized_trajectory(self, trajectory: Trajectory) -> Trajectory:
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


def make_runner(method: str, without_loop_closure: bool) -> TrajectoryRunner:
    """Make the runner of a method, with or without loop closure."""
    return (
        OdometryRunner(method)
        if without_loop_closure
        else LoopClosureRunner(method, create_synchronous_loop_closure(MapConfig()))
    )


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
