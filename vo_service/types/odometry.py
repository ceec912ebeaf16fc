"""What an odometry method is, what times its stages, and what defers its work."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from drivers.camera import RgbdFrame
from vo_service.types.estimate import Estimate


class Odometry(Protocol):
    """An odometry method, which estimates the camera's motion; each of `METHODS` makes one."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose at this frame; frames come in the order of their stamps.

        Never raises for what the camera sees: `Estimate.ok` is then False.
        """
        ...


class StageTimer(Protocol):
    """Timer of the stages of one frame: ``with timer.stage("surf"): ...``."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        ...


class NullStageTimer:
    """Timer that measures nothing."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Do nothing."""
        return nullcontext()


class WorkQueue(Protocol):
    """Takes work of a frame that its estimate does not need, but the next one does."""

    def add(self, work: Callable[[], None]) -> None:
        """Do the work now or later, after all that was added before."""
        ...

    def run(self) -> None:
        """Do what is left to do."""
        ...


class ImmediateWork:
    """Does work as soon as it is added."""

    def add(self, work: Callable[[], None]) -> None:
        """Do it."""
        work()

    def run(self) -> None:
        """Do nothing."""


class DeferredWork:
    """Keeps work until `run`, which is called between two estimates."""

    def __init__(self) -> None:
        self._waiting: list[Callable[[], None]] = []

    def add(self, work: Callable[[], None]) -> None:
        """Keep it."""
        self._waiting.append(work)

    def run(self) -> None:
        """Do all of it."""
        waiting, self._waiting = self._waiting, []
        for work in waiting:
            work()
