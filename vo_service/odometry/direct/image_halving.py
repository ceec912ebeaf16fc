"""Large images are halved before the odometry: it takes as long for them as for a Kinect's."""

from dataclasses import replace

import cv2
import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.odometry.direct.parameters import MAX_IMAGE_PX
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry


class HalvingOdometry:
    """Runs an odometry on images that are at most `MAX_IMAGE_PX` long."""

    def __init__(self, odometry: Odometry) -> None:
        self._odometry = odometry

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose; see `Odometry`. Pixels are those of the frame."""
        scale = 1
        while max(frame.camera.width, frame.camera.height) > MAX_IMAGE_PX:
            frame, scale = halve(frame), 2 * scale
        estimate = self._odometry.estimate(frame)
        return estimate if scale == 1 else replace(estimate, debug=estimate.debug.scaled(scale))


def halve(frame: RgbdFrame) -> RgbdFrame:
    """Return a frame of half the size; (u, v) of it is (2 u, 2 v) of the frame.

    Brightness is the weighted mean around every second pixel, depth that of this pixel: a mean of
    depths would be between two surfaces.
    """
    camera = frame.camera
    return replace(
        frame,
        color_bgr=np.asarray(cv2.pyrDown(frame.color_bgr), np.uint8),
        depth_raw=np.ascontiguousarray(frame.depth_raw[::2, ::2]),
        camera=PinholeCamera(
            (camera.width + 1) // 2,
            (camera.height + 1) // 2,
            camera.fx / 2,
            camera.fy / 2,
            camera.cx / 2,
            camera.cy / 2,
        ),
    )
