"""What the benchmarks of long ways run: an odometry, alone or with what knows places again."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.geometry import Array
from drivers.trajectory import StampedPoses
from vo_service.methods import METHODS, FeatureSettings
from vo_service.odometry.estimate import Estimate
from vo_service.stage_clock import StageClock


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

    def corrected(self, trajectory: StampedPoses) -> StampedPoses:
        """See `Runner`."""
        return trajectory

    def loops(self) -> Sequence[Loop]:
        """See `Runner`."""
        return ()


def make_runner(method: str) -> Runner:
    """What is measured, by the name of its method."""
    return OdometryRunner(method)
