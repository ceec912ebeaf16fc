"""What the benchmarks of long ways run: an odometry, alone or with what knows places again."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.geometry import Array
from drivers.trajectory import StampedPoses
from vo_service.mapping.loops.inline import InlineLoops
from vo_service.mapping.loops.opening import open_inline_loops
from vo_service.methods import METHODS, FeatureSettings
from vo_service.pose_tracker import PoseTracker, StampedFrame
from vo_service.settings import MapSettings
from vo_service.stage_clock import StageClock
from vo_service.types import Estimate, PoseUpdate


@dataclass(frozen=True)
class Loop:
    """A place that was known again, and believed: T_place_camera, 4x4, between two frames."""

    place_stamp_s: float
    stamp_s: float
    T_place_camera: Array


class Runner(Protocol):
    """Frames in, poses out, and what became of them in the end."""

    def frame(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is. Frames come in order, once each."""
        ...

    def learn(self) -> None:
        """What is done once the pose has gone out."""
        ...

    def corrected(self, trajectory: StampedPoses) -> StampedPoses:
        """The poses that `frame` gave, as they are thought to be after the last frame."""
        ...

    def loops(self) -> Sequence[Loop]:
        """All of them so far."""
        ...


class OdometryRunner:
    """The odometry alone: it corrects nothing afterwards, and knows no loops."""

    def __init__(self, method: str) -> None:
        self._odometry = METHODS[method](FeatureSettings(), StageClock())

    def frame(self, frame: RgbdFrame) -> Estimate:
        """See `Runner`."""
        return self._odometry.estimate(frame)

    def learn(self) -> None:
        """See `Runner`."""

    def corrected(self, trajectory: StampedPoses) -> StampedPoses:
        """See `Runner`."""
        return trajectory

    def loops(self) -> Sequence[Loop]:
        """See `Runner`."""
        return ()


class LoopRunner:
    """An odometry that knows places again, and closes loops between two frames."""

    def __init__(self, method: str, known: InlineLoops) -> None:
        """`known` is the map, which may know places from before; `told` is what went out last."""
        self.map = known
        self._odometry = known.around(METHODS[method](FeatureSettings(), StageClock()))
        self._tracker = PoseTracker()
        self.told: PoseUpdate | None = None

    def frame(self, frame: RgbdFrame) -> Estimate:
        """See `Runner`."""
        estimate = self._odometry.estimate(frame)
        self.told = self._tracker.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0)
        return estimate

    def learn(self) -> None:
        """See `Runner`."""
        if self.told is not None:
            self.map.pose(self.told)

    def corrected(self, trajectory: StampedPoses) -> StampedPoses:
        """See `Runner`."""
        return self.map.trajectory

    def loops(self) -> Sequence[Loop]:
        """See `Runner`. Those of a place that was left out since are told by its neighbour."""
        places = self.map.closer.places
        return [
            Loop(places[edge.a].stamp_s, places[edge.b].stamp_s, edge.T_a_b)
            for edge in self.map.closer.graph.edges
            if edge.is_loop
        ]


def make_runner(method: str, alone: bool) -> Runner:
    """What is measured: a method by its name, alone or with what knows places again."""
    return OdometryRunner(method) if alone else LoopRunner(method, open_inline_loops(MapSettings()))
