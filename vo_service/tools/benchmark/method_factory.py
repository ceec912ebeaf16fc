"""How a method is made in the process that runs it."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Protocol

from drivers.core.errors import InputError
from drivers.core.trajectory import Trajectory
from vo_service.config import OdometryConfig, make_odometry
from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.warm_up import warm_up
from vo_service.tools.benchmark.reference_scale import GroundTruthDistance
from vo_service.types import Odometry


class SfmScale(StrEnum):
    """Where a method without a scale of its own gets its first metre from."""

    FIRST_DEPTH = "first-depth"
    GROUND_TRUTH = "ground-truth"


class MethodFactory(Protocol):
    """Makes an odometry. Goes to another process, so it can be pickled."""

    @property
    def settings(self) -> Mapping[str, object]:
        """All that changes the result, for JSON."""
        ...

    @property
    def uses_truth(self) -> bool:
        """Whether the ground truth changes the result."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile what is to be compiled, and tell what is being done."""
        ...

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> Odometry:
        """The odometry."""
        ...


@dataclass(frozen=True)
class ConfiguredMethodFactory:
    """A method with the settings of a configuration; see `Recipe`."""

    odometry: OdometryConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table."""
        return asdict(self.odometry)

    @property
    def uses_truth(self) -> bool:
        """It sees the frames alone."""
        return False

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, on_progress)

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> Odometry:
        """As the service makes it."""
        return make_odometry(self.odometry, stopwatch)


@dataclass(frozen=True)
class TrueScaleSfmFactory:
    """The color-only method with its first scale from the ground truth; see `Recipe`."""

    odometry: OdometryConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table, and where the scale comes from."""
        return {**asdict(self.odometry), "sfm_scale": SfmScale.GROUND_TRUTH}

    @property
    def uses_truth(self) -> bool:
        """The distance between its first two places."""
        return True

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, on_progress)

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> Odometry:
        """As the service makes it, but for the scale. Raises InputError without truth."""
        from vo_service.odometry.sfm.odometry import SfmOdometry
        from vo_service.odometry.sfm.scale_source import GivenBaselineScale
        from vo_service.odometry.surf import SurfExtractor

        if truth is None:
            raise InputError("no groundtruth.txt, which --sfm-scale ground-truth needs")
        return SfmOdometry(
            SurfExtractor(self.odometry.feature_count, self.odometry.upright),
            timer=stopwatch,
            scale_source=GivenBaselineScale(GroundTruthDistance(truth)),
        )
