"""A frame as the next ones need it: its features, and the points in space under them."""

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
    """What is kept of a frame.

    features  where they are in the image, and what they look like
    points    the same features in space, in the camera's axes
    camera    intrinsics of the image
    stamp_s   of the frame
    """

    features: Features
    points: FeaturePoints
    camera: PinholeCamera
    stamp_s: float


def select_pairs_with_depth(
    view: FeatureView, reference: FeatureView, pairs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Those pairs (M, 2) of features, of the view and of its reference, that both have depth."""
    return pairs[view.points.has_depth[pairs[:, 0]] & reference.points.has_depth[pairs[:, 1]]]


def make_tracking_debug(
    view: FeatureView,
    reference: FeatureView,
    matches: NDArray[np.int64],
    motion: RigidMotionEstimate,
) -> TrackingDebug:
    """What a viewer can draw of matches (M, 2) and the motion found by them."""
    return TrackingDebug(
        keypoints_px=view.features.position_px,
        matches_px=view.features.position_px[matches[:, 0]],
        reference_matches_px=reference.features.position_px[matches[:, 1]],
        inlier=motion.inlier,
    )
