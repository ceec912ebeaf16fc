"""An odometry made of a method that aligns two frames."""

from typing import Any, Protocol

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array
from vo_service.types import Estimate

# After so many frames without success it begins afresh, as `SurfOdometry` does.
MAX_FAILURES = 30


class PairwiseMethod(Protocol):
    """Aligns two frames."""

    def prepare(self, frame: RgbdFrame) -> Any:
        """What is needed of a frame, both as the later and as the earlier one."""
        ...

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """4x4 T_earlier_later from an expected one; None without success."""
        ...


class FrameToFrame:
    """Each frame against the last good one; it expects the motion to go on as it was.

    A frame that fails is left out of the chain.
    """

    def __init__(self, method: PairwiseMethod) -> None:
        self._method = method
        self._last: Any = None
        self._T_world_last = np.eye(4)
        self._step = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the last good one."""
        view = self._method.prepare(frame)
        if self._last is None:
            return self._go_on(view, np.eye(4))
        step = self._method.align(self._last, view, self._step)
        return self._fail(view) if step is None else self._go_on(view, step)

    def _go_on(self, view: Any, step: Array, restarted: bool = False) -> Estimate:
        self._last = view
        self._step = step
        self._T_world_last = self._T_world_last @ step
        self._failures = 0
        return self._answer("", step, restarted)

    def _fail(self, view: Any) -> Estimate:
        self._failures += 1
        self._step = np.eye(4)
        if self._failures > MAX_FAILURES:
            return self._go_on(view, np.eye(4), restarted=True)
        return self._answer("no alignment", np.eye(4))

    def _answer(self, reason: str, step: Array, restarted: bool = False) -> Estimate:
        """These methods say nothing of their covariance."""
        unknown = np.zeros((6, 6))
        pose = self._T_world_last.copy()
        return Estimate(not reason, reason, pose, step, unknown, restarted=restarted)
