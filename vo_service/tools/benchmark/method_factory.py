"""Factories that make a method in the process that runs it."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Protocol

from drivers.core.errors import InputError
from drivers.tum.folder import TumFolder
from vo_service.config import OdometryConfig
from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.registry import warm_up
from vo_service.tools.benchmark.reference_scale import GroundTruthDistance
from vo_service.types import Odometry


class SfmScale(StrEnum):
    """Source of the first scale of a method without metric scale."""

    FIRST_DEPTH = "first-depth"
    GROUND_TRUTH = "ground-truth"


class MethodFactory(Protocol):
    """Picklable factory of an odometry."""

    @property
    def settings(self) -> Mapping[str, object]:
        """All settings that change the result, for JSON."""
        ...

    @property
    def uses_truth(self) -> bool:
        """Whether the ground truth changes the result."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels; `on_progress` is called with each stage."""
        ...

    def make(self, stopwatch: StageTimer, recording: TumFolder) -> Odometry:
        """Make the odometry. `recording` has the frames that it will get."""
        ...


@dataclass(frozen=True)
class ConfiguredMethodFactory:
    """Factory of one of our methods with the settings of a configuration."""

    odometry: OdometryConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table."""
        return asdict(self.odometry)

    @property
    def uses_truth(self) -> bool:
        """False: only the frames are used."""
        return False

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, on_progress)

    def make(self, stopwatch: StageTimer, recording: TumFolder) -> Odometry:
        """Make the odometry as the service does."""
        return self.odometry.make_odometry(stopwatch)


@dataclass(frozen=True)
class TrueScaleSfmFactory:
    """Factory of the color-only method with its first scale from the ground truth."""

    odometry: OdometryConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table and the source of the scale."""
        return {**asdict(self.odometry), "sfm_scale": SfmScale.GROUND_TRUTH}

    @property
    def uses_truth(self) -> bool:
        """True: the distance between its first two keyframes is used."""
        return True

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, on_progress)

    def make(self, stopwatch: StageTimer, recording: TumFolder) -> Odometry:
        """Make the odometry, with scale from the truth. Raises InputError without a truth."""
        from vo_service.odometry.sfm.odometry import SfmOdometry
        from vo_service.odometry.sfm.scale_source import GivenBaselineScale
        from vo_service.odometry.surf import SurfExtractor

        truth = recording.ground_truth
        if truth is None:
            raise InputError("no groundtruth.txt, which --sfm-scale ground-truth needs")
        return SfmOdometry(
            SurfExtractor(self.odometry.feature_count, self.odometry.upright),
            timer=stopwatch,
            scale_source=GivenBaselineScale(GroundTruthDistance(truth)),
        )
