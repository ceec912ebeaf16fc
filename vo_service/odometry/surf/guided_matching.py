"""Guided matching: features are searched near their predicted positions, with a weaker ratio test.

The search by projection of Klein and Murray (PTAM, ISMAR 2007, Section 5.3).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transform_points
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.features import FeatureView, select_pairs_with_depth
from vo_service.odometry.motion_model import MotionPrediction
from vo_service.odometry.surf import Features

# The second nearest descriptor in the search radius is further by 1/RATIO.
MAX_DISTANCE_RATIO = 0.9
# The nearest one, which may have no second, differs by at most this share of the descriptor's norm.
MAX_RELATIVE_DISTANCE = 0.6
# Smallest depth of a predicted point.
MIN_DEPTH_M = 0.1
# Larger than any squared difference.
INFINITE_DISTANCE = 2**62

Descriptors = NDArray[np.int16]


@dataclass(frozen=True)
class PredictedFeatures:
    """Features of the reference that are predicted in view.

    Attributes:
        index: (K,) indices of the reference's features.
        position_px: (K, 2) predicted positions.
    """

    index: NDArray[np.intp]
    position_px: Array


def match_by_prediction(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> NDArray[np.int64]:
    """Match features near their predicted positions: pairs (M, 2) of a view and its reference.

    Both have depth and each is the other's nearest; bright and dark blobs are never compared.
    """
    predicted = _project_reference(view, reference, prediction)
    radius_px = view.camera.fx * float(np.tan(prediction.spread_rad))
    # Sorted by x, so that neighbors are contiguous.
    queries = np.argsort(view.features.position_px[:, 0], kind="stable")
    blocks = [np.empty((0, 2), np.int64)]
    for sign in (-1.0, 1.0):
        rows = queries[view.features.sign[queries] == sign]
        predicted_rows = np.flatnonzero(reference.features.sign[predicted.index] == sign)
        nearest = match_within_radius(
            predicted.position_px[predicted_rows],
            _descriptors(reference.features, predicted.index[predicted_rows]),
            view.features.position_px[rows].astype(np.float64),
            _descriptors(view.features, rows),
            radius_px,
        )
        matched = np.flatnonzero(nearest >= 0)
        pairs = np.column_stack([rows[nearest[matched]], predicted.index[predicted_rows[matched]]])
        blocks.append(pairs.astype(np.int64))
    pairs = select_pairs_with_depth(view, reference, np.concatenate(blocks))
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def _project_reference(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> PredictedFeatures:
    """Project the reference's points into the predicted view."""
    points, camera = reference.points, view.camera
    P_camera = transform_points(inverse(prediction.T_reference_camera), points.position_m)
    index = np.flatnonzero(points.has_depth & (P_camera[:, 2] > MIN_DEPTH_M))
    x, y, z = P_camera[index].T
    position_px = np.column_stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    return PredictedFeatures(index, position_px)


def _descriptors(features: Features, index: NDArray[np.intp]) -> Descriptors:
    """Descriptors (N, D) of selected features as integers, whose sums are exact."""
    return features.descriptor[index].astype(np.int16)


@kernel
def match_within_radius(
    predicted_px: Array,
    predicted_descriptor: Descriptors,
    position_px: Array,
    descriptor: Descriptors,
    radius_px: float,
) -> NDArray[np.int64]:
    """Match each predicted feature within a radius.

    Args:
        predicted_px: (K, 2).
        predicted_descriptor: (K, D).
        position_px: (N, 2), ascending in x.
        descriptor: (N, D).
        radius_px: Radius of the search.

    Returns:
        (K,) the matched row of `descriptor`, -1 for none.
    """
    nearest = np.full(len(predicted_descriptor), -1, np.int64)
    closest_distance = np.full(len(descriptor), INFINITE_DISTANCE, np.int64)
    closest_row = np.full(len(descriptor), -1, np.int64)
    begin = np.searchsorted(position_px[:, 0], predicted_px[:, 0] - radius_px)
    for k in range(len(predicted_descriptor)):
        best = second = INFINITE_DISTANCE
        best_row = -1
        for n in range(begin[k], len(descriptor)):
            dx = position_px[n, 0] - predicted_px[k, 0]
            dy = position_px[n, 1] - predicted_px[k, 1]
            if dx > radius_px:
                break
            if dx * dx + dy * dy > radius_px * radius_px:
                continue
            difference = _squared_distance(predicted_descriptor[k], descriptor[n])
            if difference < best:
                best, second, best_row = difference, best, n
            elif difference < second:
                second = difference
            if difference < closest_distance[n]:
                closest_distance[n], closest_row[n] = difference, k
        squared_norm = _squared_distance(
            predicted_descriptor[k], np.zeros_like(predicted_descriptor[k])
        )
        if (
            best < MAX_DISTANCE_RATIO**2 * second
            and best <= MAX_RELATIVE_DISTANCE**2 * squared_norm
        ):
            nearest[k] = best_row
    for k in range(len(predicted_descriptor)):
        if nearest[k] >= 0 and closest_row[nearest[k]] != k:
            nearest[k] = -1
    return nearest


@inline_kernel
def _squared_distance(a: Descriptors, b: Descriptors) -> int:
    total = 0
    for d in range(len(a)):
        step = int(a[d]) - int(b[d])
        total += step * step
    return total
