"""The service's own methods, as a comparison makes them."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from drivers.trajectory import StampedPoses
from vo_service.config import OdometrySettings, make_odometry
from vo_service.odometry.estimate import Odometry
from vo_service.odometry.stopwatch import Stopwatch
from vo_service.warm_up import warm_up


@dataclass(frozen=True)
class MethodRecipe:
    """A method with the settings of a configuration; see `Recipe`."""

    odometry: OdometrySettings

    @property
    def settings(self) -> Mapping[str, object]:
        """The `[odometry]` table."""
        return asdict(self.odometry)

    @property
    def uses_truth(self) -> bool:
        """It sees the frames alone."""
        return False

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        warm_up(self.odometry.method, tell)

    def make(self, stopwatch: Stopwatch, truth: StampedPoses | None) -> Odometry:
        """As the service makes it."""
        return make_odometry(self.odometry, stopwatch)
