"""What an odometry method is, and what times its stages."""

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
