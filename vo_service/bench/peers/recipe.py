"""A peer, as a run makes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.trajectory import Trajectory
from vo_service.bench.peers.catalogue import BASELINES
from vo_service.methods import FeatureConfig
from vo_service.odometry.stopwatch import StageTimer
from vo_service.types import Odometry
from vo_service.warm_up import StageReporter, run_warm_up_frames


@dataclass(frozen=True)
class BaselineFactory:
    """One of PEERS by its name; see `Recipe`. The features are for those that have any."""

    name: str
    features: FeatureConfig

    @property
    def settings(self) -> Mapping[str, object]:
        """Which version of what."""
        package = BASELINES[self.name].package
        return {
            "peer": self.name,
            "package": f"{package.pip_names[0]} {package.version}".strip(),
            "feature_count": self.features.count,
        }

    @property
    def uses_truth(self) -> bool:
        """It sees the frames alone."""
        return False

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Load its library, and use it once."""
        on_progress(BASELINES[self.name].package.module)
        run_warm_up_frames(lambda: self.make(StageReporter(on_progress), None))

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> Odometry:
        """The odometry, new."""
        return BASELINES[self.name].make(self.features, stopwatch)
