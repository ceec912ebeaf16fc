"""What a Kinect tells of its images: the calibration of its factory, which libfreenect reads.

From the map that registers depth to color follows the focal length of the color camera.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.calibration import MILLIMETERS_PER_METER
from drivers.rectify import DepthRegistration, SourceProperties, factory_camera

# Focal lengths of a Kinect's color and depth camera at 640x480, and how far one may be from them.
USUAL_COLOR_FOCAL_PX, USUAL_DEPTH_FOCAL_PX = 525.0, 575.8
MAX_FOCAL_DEVIATION = 0.05
# Largest distance of the map's center from a straight one: lenses bend it by 0.5 px at most.
MAX_MAP_ERROR_PX = 2.0
# Largest stretch of the map in one direction: both cameras have square pixels.
MAX_MAP_STRETCH = 0.02


@dataclass(frozen=True)
class FactoryCalibration:
    """The calibration of one Kinect.

    Attributes:
        depth_focal_px: Focal length of the depth camera at 640x480.
        depth_px: (N, 2) columns and rows of the depth camera around its center.
        color_px: (N, 2) where the color camera sees them, up to a shift that depends on distance.
    """

    depth_focal_px: float
    depth_px: NDArray[np.float64]
    color_px: NDArray[np.float64]

    def color_focal_px(self) -> float:
        """Compute the focal length of the color camera.

        A direction is seen by both cameras, so the map magnifies by the ratio of the focal lengths.
        Its center is used, where lenses distort little.

        Raises:
            ValueError: The calibration is not plausible; the message has the reason.
        """
        _check_focal_px("depth", self.depth_focal_px, USUAL_DEPTH_FOCAL_PX)
        rows = np.column_stack([self.depth_px, np.ones(len(self.depth_px))])
        solution = np.linalg.lstsq(rows, self.color_px, rcond=None)[0]
        error_px = float(np.abs(rows @ solution - self.color_px).max())
        if not error_px <= MAX_MAP_ERROR_PX:
            raise ValueError(f"its registration is {error_px:.1f} px off a straight map")
        smallest, largest = np.linalg.svd(solution[:2], compute_uv=False)[::-1].tolist()
        focal_px = self.depth_focal_px * math.sqrt(smallest * largest)
        _check_focal_px("color", focal_px, USUAL_COLOR_FOCAL_PX)
        if not largest / smallest <= 1.0 + MAX_MAP_STRETCH:
            raise ValueError(f"its registration stretches by {largest / smallest - 1.0:.1%}")
        return focal_px


def _check_focal_px(camera: str, focal_px: float, usual_px: float) -> None:
    if not abs(focal_px / usual_px - 1.0) <= MAX_FOCAL_DEVIATION:
        raise ValueError(
            f"the focal length of the {camera} camera would be {focal_px:.4g} px, but Kinects have "
            f"{usual_px:g} px ± {MAX_FOCAL_DEVIATION:.0%}"
        )


SIZE = (640, 480)


def kinect_properties(
    name: str, has_depth_camera: bool, factory_focal_px: float | None
) -> SourceProperties:
    """Tell what a Kinect's images are.

    Args:
        has_depth_camera: Whether libfreenect is asked for unregistered depth.
        factory_focal_px: Focal length of the color camera by the factory; None if not known.
    """
    focal_px = factory_focal_px or USUAL_COLOR_FOCAL_PX
    return SourceProperties(
        name,
        factory_camera(SIZE, focal_px, focal_px),
        "factory" if factory_focal_px else "default",
        SIZE,
        MILLIMETERS_PER_METER,
        DepthRegistration.NO if has_depth_camera else DepthRegistration.YES,
    )
