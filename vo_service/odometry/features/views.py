"""Views: features of a frame with their 3-D points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from vo_service.odometry.depth_grid import NO_DEPTH, DepthGrid
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.features.points import FeaturePoints
from vo_service.types.estimate import TrackingDebug


@dataclass(frozen=True)
class FeatureView:
    """Features of a frame with their 3-D points.

    Attributes:
        features: Positions in the image and descriptors.
        points: The same features as 3-D points in the camera's axes.
        camera: Intrinsics of the image.
        stamp_s: Of the frame.
        depth: Coarse depth image, which may contradict a motion.
    """

    features: Features
    points: FeaturePoints
    camera: PinholeCamera
    stamp_s: float
    depth: DepthGrid = NO_DEPTH


def select_pairs_with_depth(
    view: FeatureView, reference: FeatureView, pairs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Select the pairs (M, 2) of features of a view and its reference that both have depth.

    Args:
        pairs: (M, 2) indices of features of both.
    """
    return pairs[view.points.has_depth[pairs[:, 0]] & reference.points.has_depth[pairs[:, 1]]]


def match_views(view: FeatureView, reference: FeatureView, max_ratio: float) -> NDArray[np.int64]:
    """Match the features of a view and its reference: pairs (M, 2) that both have depth.

    Args:
        max_ratio: See `match_features`.
    """
    pairs = match_features(view.features, reference.features, max_ratio)
    return select_pairs_with_depth(view, reference, pairs)


def make_tracking_debug(
    view: FeatureView,
    reference: FeatureView,
    matches: NDArray[np.int64],
    inlier: NDArray[np.bool_],
) -> TrackingDebug:
    """Make the debug data of matches (M, 2), of which (M,) are inliers of a motion.

    Args:
        matches: (M, 2) indices of features of both.
        inlier: (M,) which matches agree with the motion.
    """
    return TrackingDebug(
        keypoints_px=view.features.position_px,
        matches_px=view.features.position_px[matches[:, 0]],
        reference_matches_px=reference.features.position_px[matches[:, 1]],
        inlier=inlier,
    )
