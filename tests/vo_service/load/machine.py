"""A machine with a camera, an odometry and a viewer, all of time: for what is decided by load."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.vo_service.fakes import FakeClock
from vo_service.load.effort import Effort
from vo_service.load.governor import LoadGovernor
from vo_service.load.meter import FrameLoad
from vo_service.settings import LoadSettings

INTERVAL_S = 1 / 32  # a number that adds up without rounding

# Seconds that a frame takes, given the time and the effort.
Cost = Callable[[float, Effort], float]


@dataclass
class FakeOdometry:
    """Remembers how many features it is to look for."""

    feature_count: int = 1000


@dataclass
class FakeViewer:
    """Remembers whether it rests."""

    is_resting: bool = False

    def rest(self, is_resting: bool) -> None:
        """As told."""
        self.is_resting = is_resting


@dataclass
class Machine:
    """Plays frames to a governor; a frame that comes while the loop is busy is dropped."""

    min_features: int = 300
    odometry: FakeOdometry = field(default_factory=FakeOdometry)
    viewers: tuple[FakeViewer, ...] = field(default_factory=lambda: (FakeViewer(),))
    clock: FakeClock = field(default_factory=lambda: FakeClock(0.0))

    def __post_init__(self) -> None:
        settings = LoadSettings(min_features=self.min_features)
        self.governor = LoadGovernor(settings, self.viewers, self.odometry, self.clock)
        self.dropped = 0
        self.changes: list[tuple[float, Effort]] = []
        self._frame = 0

    def run(self, seconds: float, cost: Cost) -> None:
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
        self.governor.frame(FrameLoad(busy_s, 0.9 * busy_s, INTERVAL_S, self.dropped))
        if self.governor.effort != before:
            self.changes.append((self.clock.now_s, self.governor.effort))


def share(of_interval: float) -> Cost:
    """A frame takes this share of the interval, whatever the effort."""
    return lambda now_s, effort: of_interval * INTERVAL_S


def affine(fixed: float, features: float, viewer: float) -> Cost:
    """Shares of the interval: what is fixed, what 1000 features cost, what the viewer takes."""

    def cost(now_s: float, effort: Effort) -> float:
        viewer_share = 0.0 if effort.viewer_rests else viewer
        return (fixed + features * effort.features / 1000 + viewer_share) * INTERVAL_S

    return cost
