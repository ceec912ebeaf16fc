"""Observers of a run: none, or loop closure.

Observers change neither a method's estimates nor its times: they get each frame after both were
recorded.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

from drivers.camera import RgbdFrame
from vo_service.tools.benchmark.run import LoopClosureRun
from vo_service.types import Estimate


class RunObserver(Protocol):
    """Observer of a run."""

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Process the next frame and its estimate."""
        ...

    @property
    def result(self) -> LoopClosureRun | None:
        """Result so far; None without loop closure."""
        ...


class ObserverFactory(Protocol):
    """Picklable factory of an observer."""

    @property
    def settings(self) -> Mapping[str, object]:
        """Settings that change the result, for JSON; empty without an observer."""
        ...

    @property
    def config_tables(self) -> Mapping[str, Mapping[str, object]]:
        """Tables of the configuration that the observer uses, with their values."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile or load the kernels; `on_progress` is called with each stage."""
        ...

    def make(self) -> RunObserver:
        """Make a new observer."""
        ...


class NullObserver:
    """Factory and observer that do nothing."""

    result = None

    @property
    def settings(self) -> Mapping[str, object]:
        """No settings."""
        return {}

    @property
    def config_tables(self) -> Mapping[str, Mapping[str, object]]:
        """No tables."""
        return {}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Do nothing."""

    def make(self) -> RunObserver:
        """Return itself; it has no state."""
        return self

    def observe(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Do nothing."""


NULL_OBSERVER = NullObserver()
