"""Features of frames as 3-D points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.depth_planes import fit_inverse_depth
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.gray_frame import GrayFrame
from vo_service.odometry.uncertainty import depth_sigma_m, lateral_sigma_m


@dataclass(frozen=True)
class FeaturePoints:
    """3-D points of features in the camera's axes.

    Attributes:
        position_m: (N, 3); rows without depth are zero.
        has_depth: (N,) bool.
        sigma_across_m: (N,) standard deviation across the viewing ray.
        sigma_along_m: (N,) standard deviation along it.
    """

    position_m: Array
    has_depth: NDArray[np.bool_]
    sigma_across_m: Array
    sigma_along_m: Array


def backproject_features(features: Features, frame: RgbdFrame | GrayFrame) -> FeaturePoints:
    """Back-project features through the depth image (pinhole model).

    The depth is that of a plane fitted in 1/z around the feature, which averages the sensor's
    noise. A feature without depth, or on a depth edge, gets no point.
    """
    camera = frame.camera
    inverse_depth = fit_inverse_depth(frame.depth_m, features.position_px)
    has_depth = inverse_depth > 0
    depth_m = np.zeros(len(features))
    depth_m[has_depth] = 1.0 / inverse_depth[has_depth]
    x = (features.position_px[:, 0] - camera.cx) / camera.fx * depth_m
    y = (features.position_px[:, 1] - camera.cy) / camera.fy * depth_m
    return FeaturePoints(
        position_m=np.column_stack([x, y, depth_m]),
        has_depth=has_depth,
        sigma_across_m=lateral_sigma_m(depth_m, camera.fx),
        sigma_along_m=depth_sigma_m(depth_m),
    )


@dataclass(frozen=True)
class PointPairs:
    """3-D points of matched features.

    Attributes:
        P_camera: (M, 3) in the camera's axes.
        P_reference: (M, 3) in the reference's axes.
        sigma_across_m: (M,) standard deviation of their difference across the viewing ray.
        sigma_along_m: (M,) standard deviation of their difference along it.
    """

    P_camera: Array
    P_reference: Array
    sigma_across_m: Array
    sigma_along_m: Array

    def __len__(self) -> int:
        return len(self.P_camera)

    def select(self, selected: NDArray[np.bool_]) -> "PointPairs":
        """Select pairs, (M,) bool."""
        return PointPairs(
            self.P_camera[selected],
            self.P_reference[selected],
            self.sigma_across_m[selected],
            self.sigma_along_m[selected],
        )


def pair_points(
    points: FeaturePoints, reference: FeaturePoints, pairs: NDArray[np.int64]
) -> PointPairs:
    """Pair the points of matched features (M, 2), all of which have depth.

    Args:
        points: Of the camera's view.
        reference: Of the reference's view.
        pairs: (M, 2) indices into both.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    return PointPairs(
        P_camera=points.position_m[i],
        P_reference=reference.position_m[j],
        sigma_across_m=np.hypot(points.sigma_across_m[i], reference.sigma_across_m[j]),
        sigma_along_m=np.hypot(points.sigma_along_m[i], reference.sigma_along_m[j]),
    )
