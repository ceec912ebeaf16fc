"""Runners of the tour benchmarks: an odometry, with or without loop closure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.slam.loop_closure.factory import create_synchronous_loop_closure
from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure
from vo_service.types import Estimate, OdometryUpdate


@dataclass(frozen=True)
class LoopClosureRecord:
    """An accepted loop closure: T_keyframe_camera (4, 4) between two frames."""

    keyframe_stamp_s: float
    stamp_s: float
    T_keyframe_camera: Array


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
