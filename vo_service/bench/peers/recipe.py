"""A peer, as a run makes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.trajectory import StampedPoses
from vo_service.bench.peers.catalogue import PEERS
from vo_service.methods import FeatureSettings
from vo_service.odometry.stopwatch import Stopwatch
from vo_service.types import Odometry
from vo_service.warm_up import StageNames, try_out


@dataclass(frozen=True)
class PeerRecipe:
    """One of PEERS by its name; see `Recipe`. The features are for those that have any."""

    name: str
    features: FeatureSettings

    @property
    def settings(self) -> Mapping[str, object]:
        """Which version of what."""
        package = PEERS[self.name].package
        return {
            "peer": self.name,
            "package": f"{package.pip_names[0]} {package.version}".strip(),
            "feature_count": self.features.count,
        }

    @property
    def uses_truth(self) -> bool:
        """It sees the frames alone."""
        return False

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Load its library, and use it once."""
        tell(PEERS[self.name].package.module)
        try_out(lambda: self.make(StageNames(tell), None))

    def make(self, stopwatch: Stopwatch, truth: StampedPoses | None) -> Odometry:
        """The odometry, new."""
        return PEERS[self.name].make(self.features, stopwatch)
