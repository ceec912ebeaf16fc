"""Methods that do what a test needs: follow, hang, or go wrong in each of the known ways."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numba
import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.errors import UserFacingError
from drivers.core.trajectory import Trajectory
from vo_service.odometry.profiling import StageTimer
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.types import Estimate


def _same(number: int) -> int:
    return number


@dataclass(frozen=True)
class FaultyMethodFactory:
    """A recipe whose method stands still, until it comes to frame 3.

    act  what it does there: "go on", "lose it" (and every frame after it), "raise", "refuse",
         "segfault", "exit", "hang"; or, before any frame is counted, "compile" a kernel if none
         is kept
    """

    action: str = "go on"
    uses_truth: bool = False

    @property
    def settings(self) -> Mapping[str, object]:
        return {"act": self.action}

    def prepare(self, tell: Callable[[str], None]) -> None:
        tell("nothing")
        if self.action == "compile":
            numba.njit("i8(i8)", cache=True)(_same)

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> "FaultyMethod":
        return FaultyMethod(self.action, stopwatch)


class FaultyMethod:
    """The method of a `FaultyMethodFactory`."""

    def __init__(self, act: str, stopwatch: StageTimer) -> None:
        self._act = act
        self._stopwatch = stopwatch

    def estimate(self, frame: RgbdFrame) -> Estimate:
        with self._stopwatch.stage("standing"):
            is_lost = frame.seq >= 3 and self._act == "lose it"
            if frame.seq == 3:
                ACTIONS[self._act]()
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
    """Trials in place of the methods asked for."""
    return lambda *_: {method: FaultyMethodFactory(act) for method, act in acts.items()}
