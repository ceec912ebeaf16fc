"""OpenCV's `cv2.Odometry`, frame to frame, with default settings except for the intrinsics."""

from typing import Any

import cv2
import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array


class OpenCvOdometry:
    """`PairwiseMethod` of `cv2.Odometry`.

    Attributes:
        kind: cv2.OdometryType_RGB, _RGB_DEPTH or _DEPTH.
    """

    def __init__(self, kind: int) -> None:
        self._kind = kind
        self._odometry: Any = None

    def prepare(self, frame: RgbdFrame) -> Any:
        """Compute OpenCV's pyramids, gradients and normals, once per frame."""
        if self._odometry is None:
            settings = cv2.OdometrySettings()
            settings.setCameraMatrix(frame.camera.K.astype(np.float32))
            self._odometry = cv2.Odometry(self._kind, settings, cv2.OdometryAlgoType_COMMON)
        depth_m = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.nan))
        prepared = cv2.OdometryFrame(depth_m, frame.color_bgr)
        self._odometry.prepareFrame(prepared)
        return prepared

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align the later frame with the earlier one, without a prediction.

        The opposite order is less accurate on all recordings tried.
        """
        succeeded, T_result = self._odometry.compute(later, earlier)
        return np.asarray(T_result, np.float64) if succeeded else None
