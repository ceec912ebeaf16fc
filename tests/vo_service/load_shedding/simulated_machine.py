"""A machine with a camera, an odometry and a viewer, all of time: for what is decided by load."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.vo_service.fakes import FakeClock
from vo_service.config_tables import LoadConfig
from vo_service.load_shedding.effort_levels import EffortLevel
from vo_service.load_shedding.load_meter import FrameCost
from vo_service.load_shedding.load_shedder import StepwiseLoadShedder

INTERVAL_S = 1 / 32  # a number that adds up without rounding

# Seconds that a frame takes, given the time and the effort.
CostModel = Callable[[float, EffortLevel], float]


@dataclass
class FakeOdometry:
    """Remembers how many features it is to look for."""

    feature_count: int = 1000


@dataclass
class FakeViewer:
    """Remembers whether it rests."""

    is_paused: bool = False

    def set_paused(self, is_paused: bool) -> None:
        """As told."""
        self.is_paused = is_paused


@dataclass
class SimulatedMachine:
    """Plays frames to a governor; a frame that comes while the loop is busy is dropped."""

    min_features: int = 300
    odometry: FakeOdometry = field(default_factory=FakeOdometry)
    viewers: tuple[FakeViewer, ...] = field(default_factory=lambda: (FakeViewer(),))
    clock: FakeClock = field(default_factory=lambda: FakeClock(0.0))

    def __post_init__(self) -> None:
        settings = LoadConfig(min_features=self.min_features)
        self.governor = StepwiseLoadShedder(settings, self.viewers, self.odometry, self.clock)
        self.dropped = 0
        self.changes: list[tuple[float, EffortLevel]] = []
        self._frame = 0

    def run(self, seconds: float, cost: CostModel) -> None:
        """Process frames for so long."""
        end_s = self.clock.now_s + seconds
        while self.clock.now_s < end_s:
            due = int(self.clock.now_s / INTERVAL_S)
            self.dropped += max(0, due - self._frame - 1)
            self._frame = max(due, self._frame + 1)
            self.clock.now_s = max(self.clock.now_s, self._frame * INTERVAL_S)
            self._process(cost(self.clock.now_s, self.governor.effort))

    def _process(self, busy_s: float) -> None:
        before = self.governor.effort
        self.clock.now_s += busy_s
        self.governor.add_frame(FrameCost(busy_s, 0.9 * busy_s, INTERVAL_S, self.dropped))
        if self.governor.effort != before:
            self.changes.append((self.clock.now_s, self.governor.effort))


def proportional_cost(of_interval: float) -> CostModel:
    """A frame takes this share of the interval, whatever the effort."""
    return lambda now_s, effort: of_interval * INTERVAL_S


def affine_cost(fixed: float, features: float, viewer: float) -> CostModel:
    """Shares of the interval: what is fixed, what 1000 features cost, what the viewer takes."""

    def cost(now_s: float, effort: EffortLevel) -> float:
        viewer_share = 0.0 if effort.is_viewer_paused else viewer
        return (fixed + features * effort.feature_count / 1000 + viewer_share) * INTERVAL_S

    return cost
