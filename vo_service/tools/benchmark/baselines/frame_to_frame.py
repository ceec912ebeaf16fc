"""An odometry made of a method that aligns two frames."""

from typing import Any, Protocol

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
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


class FrameToFrameOdometry:
    """Each frame against the last good one; it expects the motion to go on as it was.

    A frame that fails is left out of the chain.
    """

    def __init__(self, method: PairwiseMethod) -> None:
        self._method = method
        self._reference: Any = None
        self._T_world_reference = np.eye(4)
        self._T_reference_camera = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the last good one."""
        view = self._method.prepare(frame)
        if self._reference is None:
            return self._accept(view, np.eye(4))
        step = self._method.align(self._reference, view, self._T_reference_camera)
        return self._reject(view) if step is None else self._accept(view, step)

    def _accept(self, prepared: Any, step: Array, restarted: bool = False) -> Estimate:
        self._reference = prepared
        self._T_reference_camera = step
        self._T_world_reference = self._T_world_reference @ step
        self._failures = 0
        return self._make_estimate("", step, restarted)

    def _reject(self, prepared: Any) -> Estimate:
        self._failures += 1
        self._T_reference_camera = np.eye(4)
        if self._failures > MAX_FAILURES:
            return self._accept(prepared, np.eye(4), restarted=True)
        return self._make_estimate("no alignment", np.eye(4))

    def _make_estimate(self, reason: str, step: Array, restarted: bool = False) -> Estimate:
        """These methods say nothing of their covariance."""
        unknown = np.zeros((6, 6))
        pose = self._T_world_reference.copy()
        return Estimate(not reason, reason, pose, step, unknown, is_reset=restarted)
