"""A depth image that is repeated tells nothing of its frame: it was taken with an earlier one.

A sensor whose depth is slower than its color delivers such frames. The motion between the two
images would be taken for an error of all poses.
"""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.odometry.direct.quality import NO_DEPTH
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry

# Noise changes every depth image in each of these rows.
ROW_STRIDE = 16
REPEATED = "brightness only: the depth image is that of the frame before"


class RepeatedDepthFilter:
    """Runs an odometry on frames whose repeated depth is removed, so that brightness counts."""

    def __init__(self, odometry: Odometry) -> None:
        self._odometry = odometry
        self._last: RgbdFrame | None = None

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose; see `Odometry`."""
        last, self._last = self._last, frame
        if last is None or not _is_depth_repeated(last, frame):
            return self._odometry.estimate(frame)
        without_depth = replace(frame, depth_raw=np.zeros_like(frame.depth_raw))
        estimate = self._odometry.estimate(without_depth)
        return replace(estimate, reason=REPEATED) if estimate.reason == NO_DEPTH else estimate


def _is_depth_repeated(last: RgbdFrame, frame: RgbdFrame) -> bool:
    """Whether a frame has the depth of the last one, and another color image."""
    rows = slice(None, None, ROW_STRIDE)
    depth = frame.depth_raw[rows]
    return (
        np.array_equal(depth, last.depth_raw[rows])
        and bool(depth.any())
        and not np.array_equal(frame.color_bgr[rows], last.color_bgr[rows])
    )
