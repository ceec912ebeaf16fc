"""The service's own methods, as a run makes them."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from drivers.errors import InputError
from drivers.trajectory import Trajectory
from vo_service.config import OdometryConfig, make_odometry
from vo_service.odometry.stopwatch import StageTimer
from vo_service.runs.recipe import SfmScale
from vo_service.runs.true_scale import GroundTruthDistance
from vo_service.types import Odometry
from vo_service.warm_up import warm_up


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
    """The colour-only method with its first scale from the ground truth; see `Recipe`."""

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
        from vo_service.odometry.sfm.scale_source import GivenBaselineScale
        from vo_service.odometry.sfm_odometry import SfmOdometry
        from vo_service.odometry.surf import SurfExtractor

        if truth is None:
            raise InputError("no groundtruth.txt, which --sfm-scale ground-truth needs")
        return SfmOdometry(
            SurfExtractor(self.odometry.feature_count, self.odometry.upright),
            timer=stopwatch,
            scale_source=GivenBaselineScale(GroundTruthDistance(truth)),
        )
