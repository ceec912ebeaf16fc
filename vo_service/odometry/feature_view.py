"""Features of a frame and their 3-D points, as kept for matching with later frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from vo_service.odometry.feature_points import FeaturePoints
from vo_service.odometry.motion_refinement import RigidMotionEstimate
from vo_service.odometry.surf import Features
from vo_service.types import TrackingDebug


@dataclass(frozen=True)
class FeatureView:
    """Features of a frame with their 3-D points.

    Attributes:
        features: Positions in the image and descriptors.
        points: The same features as 3-D points in the camera's axes.
        camera: Intrinsics of the image.
        stamp_s: Of the frame.
    """

    features: Features
    points: FeaturePoints
    camera: PinholeCamera
    stamp_s: float


def select_pairs_with_depth(
    view: FeatureView, reference: FeatureView, pairs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Select the pairs (M, 2) of features of a view and its reference that both have depth."""
    return pairs[view.points.has_depth[pairs[:, 0]] & reference.points.has_depth[pairs[:, 1]]]


def make_tracking_debug(
    view: FeatureView,
    reference: FeatureView,
    matches: NDArray[np.int64],
    motion: RigidMotionEstimate,
) -> TrackingDebug:
    """Make the debug data of matches (M, 2) and the motion estimated from them."""
    return TrackingDebug(
        keypoints_px=view.features.position_px,
        matches_px=view.features.position_px[matches[:, 0]],
        reference_matches_px=reference.features.position_px[matches[:, 1]],
        inlier=motion.inlier,
    )
