"""Simulated machine with a camera, an odometry and a viewer, in simulated time."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.vo_service.fakes import FakeClock
from vo_service.config_tables import LoadConfig
from vo_service.load_shedding import EffortLevel, FrameCost, StepwiseLoadShedder

INTERVAL_S = 1 / 32  # a number that adds up without rounding

# Seconds that a frame takes, given the time and the effort.
CostModel = Callable[[float, EffortLevel], float]


@dataclass
class FakeOdometry:
    """Stores its feature count."""

    feature_count: int = 1000


@dataclass
class FakeViewer:
    """Stores whether it is paused."""

    is_paused: bool = False

    def set_paused(self, is_paused: bool) -> None:
        """Store the state."""
        self.is_paused = is_paused


@dataclass
class SimulatedMachine:
    """Sends frame costs to a load shedder; frames during a busy loop are dropped."""

    min_features: int = 300
    odometry: FakeOdometry = field(default_factory=FakeOdometry)
    viewers: tuple[FakeViewer, ...] = field(default_factory=lambda: (FakeViewer(),))
    clock: FakeClock = field(default_factory=lambda: FakeClock(0.0))

    def __post_init__(self) -> None:
        settings = LoadConfig(min_features=self.min_features)
        self.load_shedder = StepwiseLoadShedder(settings, self.viewers, self.odometry, self.clock)
        self.dropped = 0
        self.changes: list[tuple[float, EffortLevel]] = []
        self._frame = 0

    def run(self, seconds: float, cost: CostModel) -> None:
        """Process frames for this long."""
        end_s = self.clock.now_s + seconds
        while self.clock.now_s < end_s:
            due = int(self.clock.now_s / INTERVAL_S)
            self.dropped += max(0, due - self._frame - 1)
            self._frame = max(due, self._frame + 1)
            self.clock.now_s = max(self.clock.now_s, self._frame * INTERVAL_S)
            self._process(cost(self.clock.now_s, self.load_shedder.effort))

    def _process(self, busy_s: float) -> None:
        before = self.load_shedder.effort
        self.clock.now_s += busy_s
        self.load_shedder.add_frame(FrameCost(busy_s, 0.9 * busy_s, INTERVAL_S, self.dropped))
        if self.load_shedder.effort != before:
            self.changes.append((self.clock.now_s, self.load_shedder.effort))


def proportional_cost(interval_share: float) -> CostModel:
    """Make a cost of this share of the interval, independent of the effort."""
    return lambda now_s, effort: interval_share * INTERVAL_S


def affine_cost(fixed: float, features: float, viewer: float) -> CostModel:
    """Make a cost from shares of the interval: fixed, per 1000 features, and of the viewer."""

    def cost(now_s: float, effort: EffortLevel) -> float:
        viewer_share = 0.0 if effort.is_viewer_paused else viewer
        return (fixed + features * effort.feature_count / 1000 + viewer_share) * INTERVAL_S

    return cost
