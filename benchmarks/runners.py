"""What the benchmarks of long ways run: an odometry, alone or with what knows places again."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, FeatureConfig
from vo_service.slam.loop_closure.factory import create_synchronous_loop_closure
from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure
from vo_service.types import Estimate, OdometryUpdate


@dataclass(frozen=True)
class LoopClosureRecord:
    """A place that was known again, and believed: T_place_camera, 4x4, between two frames."""

    keyframe_stamp_s: float
    stamp_s: float
    T_keyframe_camera: Array


class TrajectoryRunner(Protocol):
    """Frames in, poses out, and what became of them in the end."""

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is. Frames come in order, once each."""
        ...

    def update_map(self) -> None:
        """What is done once the pose has gone out."""
        ...

    def optimized_trajectory(self, trajectory: Trajectory) -> Trajectory:
        """The poses that `frame` gave, as they are thought to be after the last frame."""
        ...

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """All of them so far."""
        ...


class OdometryRunner:
    """The odometry alone: it corrects nothing afterwards, and knows no loops."""

    def __init__(self, method: str) -> None:
        self._odometry = METHODS[method](FeatureConfig(), CpuStageTimer())

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
    """An odometry that knows places again, and closes loops between two frames."""

    def __init__(self, method: str, known: SynchronousLoopClosure) -> None:
        """`known` is the map, which may know places from before; `told` is what went out last."""
        self.map = known
        self._odometry = known.wrap(METHODS[method](FeatureConfig(), CpuStageTimer()))
        self._tracker = OdomFrame()
        self.told: OdometryUpdate | None = None

    def estimate_pose(self, frame: RgbdFrame) -> Estimate:
        """See `TrajectoryRunner`."""
        estimate = self._odometry.estimate(frame)
        self.told = self._tracker.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0)
        return estimate

    def update_map(self) -> None:
        """See `TrajectoryRunner`."""
        if self.told is not None:
            self.map.on_update(self.told)

    def optimized_trajectory(self, trajectory: Trajectory) -> Trajectory:
        """See `TrajectoryRunner`."""
        return self.map.trajectory

    def loop_closures(self) -> Sequence[LoopClosureRecord]:
        """See `TrajectoryRunner`. Those of a place that was left out since are told by its neighbour."""
        places = self.map.loop_closer.database
        return [
            LoopClosureRecord(places[edge.a].stamp_s, places[edge.b].stamp_s, edge.T_a_b)
            for edge in self.map.loop_closer.graph.edges
            if edge.is_loop
        ]


def make_runner(method: str, without_loop_closure: bool) -> TrajectoryRunner:
    """What is measured: a method by its name, alone or with what knows places again."""
    return (
        OdometryRunner(method)
        if without_loop_closure
        else LoopClosureRunner(method, create_synchronous_loop_closure(MapConfig()))
    )
