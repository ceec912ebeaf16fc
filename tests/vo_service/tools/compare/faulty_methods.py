"""Methods that succeed, hang or fail as a test needs it."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numba
import numpy as np

from drivers.camera import RgbdFrame
from drivers.core import UserFacingError
from drivers.recording.recording import Recording
from vo_service.tools.compare.methods import MethodFactory
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import StageTimer


def _identity(number: int) -> int:
    return number


@dataclass(frozen=True)
class FaultyMethodFactory:
    """Factory of a method that reports no motion and performs an action at frame 3.

    Attributes:
        action: "go on", "lose it" (and all later frames), "raise", "refuse", "segfault", "exit"
            or "hang"; "compile" compiles a kernel in the preparation if none is cached.
        uses_truth: value of the property.
    """

    action: str = "go on"
    uses_truth: bool = False

    @property
    def settings(self) -> Mapping[str, object]:
        return {"act": self.action}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        on_progress("nothing")
        if self.action == "compile":
            numba.njit("i8(i8)", cache=True)(_identity)

    def make(self, stopwatch: StageTimer, recording: Recording) -> "FaultyMethod":
        return FaultyMethod(self.action, stopwatch)


class FaultyMethod:
    """Method of a `FaultyMethodFactory`."""

    def __init__(self, action: str, stopwatch: StageTimer) -> None:
        self._action = action
        self._stopwatch = stopwatch

    def estimate(self, frame: RgbdFrame) -> Estimate:
        with self._stopwatch.stage("static"):
            is_lost = frame.seq >= 3 and self._action == "lose it"
            if frame.seq == 3:
                ACTIONS[self._action]()
        reason = "7 of 20 matches agree" if is_lost else ""
        return Estimate(not is_lost, reason, np.eye(4), np.eye(4), np.zeros((6, 6)), inliers=50)


def _divide() -> None:
    print(1 // 0)


def _refuse() -> None:
    raise UserFacingError("out of luck; try again")


def _hang() -> None:
    threading.Event().wait()


def _nothing() -> None:
    pass


ACTIONS: Mapping[str, Callable[[], object]] = {
    "go on": _nothing,
    "lose it": _nothing,
    "raise": _divide,
    "refuse": _refuse,
    "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "exit": lambda: sys.exit("enough"),
    "hang": _hang,
    "compile": _nothing,
}


def make_faulty_factories(**acts: str) -> Callable[..., dict[str, MethodFactory]]:
    """Return a function that makes faulty methods in place of the real ones."""
    return lambda *_: {method: FaultyMethodFactory(action) for method, action in acts.items()}
