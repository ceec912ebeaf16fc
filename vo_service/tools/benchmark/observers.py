"""Who else hears what a method says in a run: nobody, or what knows places again.

Listeners change nothing of what the method says, nor of its times: they hear each frame after both
were taken down.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

from drivers.camera import RgbdFrame
from vo_service.tools.benchmark.run import LoopClosureRun
from vo_service.types import Estimate


class RunObserver(Protocol):
    """Hears a run."""

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Take what the method says of the next frame."""
        ...

    @property
    def result(self) -> LoopClosureRun | None:
        """What has come of it by now; None of nothing."""
        ...


class ObserverFactory(Protocol):
    """Makes a listener. Goes to another process, so it can be pickled."""

    @property
    def settings(self) -> Mapping[str, object]:
        """What a run is told apart by, for JSON; empty where nothing is added to it."""
        ...

    @property
    def config_tables(self) -> Mapping[str, Mapping[str, object]]:
        """The tables of a configuration that count, with what was chosen there."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile what is to be compiled, and tell what is being done."""
        ...

    def make(self) -> RunObserver:
        """A listener, new."""
        ...


class NullObserver:
    """Nobody listens: recipe and listener."""

    result = None

    @property
    def settings(self) -> Mapping[str, object]:
        """Nothing."""
        return {}

    @property
    def config_tables(self) -> Mapping[str, Mapping[str, object]]:
        """None."""
        return {}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Nothing to prepare."""

    def make(self) -> RunObserver:
        """Itself: it has no state."""
        return self

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Not."""


NULL_OBSERVER = NullObserver()
