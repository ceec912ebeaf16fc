"""Odometry from a method that aligns two frames."""

from typing import Any, Protocol

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.types import Estimate

# After this many failed frames, tracking is reset, as in `SurfOdometry`.
MAX_FAILURES = 30


class PairwiseMethod(Protocol):
    """Method that aligns two frames."""

    def prepare(self, frame: RgbdFrame) -> Any:
        """Prepare a frame for alignment, as the later and as the earlier one."""
        ...

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Return the 4x4 T_earlier_later from a predicted one, or None on failure."""
        ...


class FrameToFrameOdometry:
    """Odometry that aligns each frame with the last good one, with a constant-velocity prediction.

    Failed frames are skipped.
    """

    def __init__(self, method: PairwiseMethod) -> None:
        self._method = method
        self._reference: Any = None
        self._T_world_reference = np.eye(4)
        self._T_reference_camera = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose from this frame and the last good one."""
        prepared = self._method.prepare(frame)
        if self._reference is None:
            return self._accept(prepared, np.eye(4))
        step = self._method.align(self._reference, prepared, self._T_reference_camera)
        return self._reject(prepared) if step is None else self._accept(prepared, step)

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
        """Make an estimate without covariance, because these methods give none."""
        unknown = np.zeros((6, 6))
        pose = self._T_world_reference.copy()
        return Estimate(not reason, reason, pose, step, unknown, is_reset=restarted)
