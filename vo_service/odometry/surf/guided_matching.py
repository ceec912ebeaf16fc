"""Matching where features are expected: a prediction says where to look, so less must look alike.

The search by projection of Klein and Murray (PTAM, ISMAR 2007, Section 5.3).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transform_points
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.feature_view import FeatureView, select_pairs_with_depth
from vo_service.odometry.motion_model import MotionPrediction
from vo_service.odometry.surf import Features

# The second nearest of the few near the expected place must be further by 1/RATIO, ...
MAX_DISTANCE_RATIO = 0.9
# ... and as there may be no second, the nearest may differ by no more than this share of itself.
MAX_RELATIVE_DISTANCE = 0.6
# Nearer to the camera than this, a point is not looked for.
MIN_DEPTH_M = 0.1
# More than the square of any difference.
INFINITE_DISTANCE = 2**62

Descriptors = NDArray[np.int16]


@dataclass(frozen=True)
class PredictedFeatures:
    """Features of the reference that ought to be seen.

    index        (K,) which of the reference's features
    position_px  (K, 2) where they ought to be
    """

    index: NDArray[np.intp]
    position_px: Array


def match_by_prediction(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> NDArray[np.int64]:
    """Pairs (M, 2) of features of a view and of its reference, both with depth.

    They lie where the prediction says, look alike and are each other's nearest; bright and dark
    blobs are never compared.
    """
    expected = _project_reference(view, reference, prediction)
    radius_px = view.camera.fx * float(np.tan(prediction.spread_rad))
    # Rising in x, so that those near a place stand together.
    queries = np.argsort(view.features.position_px[:, 0], kind="stable")
    blocks = [np.empty((0, 2), np.int64)]
    for sign in (-1.0, 1.0):
        rows = queries[view.features.sign[queries] == sign]
        sought = np.flatnonzero(reference.features.sign[expected.index] == sign)
        nearest = match_within_radius(
            expected.position_px[sought],
            _descriptors(reference.features, expected.index[sought]),
            view.features.position_px[rows].astype(np.float64),
            _descriptors(view.features, rows),
            radius_px,
        )
        found = np.flatnonzero(nearest >= 0)
        pairs = np.column_stack([rows[nearest[found]], expected.index[sought[found]]])
        blocks.append(pairs.astype(np.int64))
    pairs = select_pairs_with_depth(view, reference, np.concatenate(blocks))
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def _project_reference(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> PredictedFeatures:
    """The reference's points that lie before the camera, projected into its image."""
    points, camera = reference.points, view.camera
    P_camera = transform_points(inverse(prediction.T_reference_camera), points.position_m)
    index = np.flatnonzero(points.has_depth & (P_camera[:, 2] > MIN_DEPTH_M))
    x, y, z = P_camera[index].T
    position_px = np.column_stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    return PredictedFeatures(index, position_px)


def _descriptors(features: Features, index: NDArray[np.intp]) -> Descriptors:
    """Descriptors (N, D) of some features; they are whole numbers, and sums of those are exact."""
    return features.descriptor[index].astype(np.int16)


@kernel
def match_within_radius(
    predicted_px: Array,
    predicted_descriptor: Descriptors,
    position_px: Array,
    descriptor: Descriptors,
    radius_px: float,
) -> NDArray[np.int64]:
    """(K,) the row of `descriptor` that each feature sought is found at, -1 where there is none.

    expected_px (K, 2) with sought (K, D); position_px (N, 2), rising in x, with descriptor (N, D).
    """
    nearest = np.full(len(predicted_descriptor), -1, np.int64)
    closest = np.full(len(descriptor), INFINITE_DISTANCE, np.int64)
    closest_to = np.full(len(descriptor), -1, np.int64)
    begin = np.searchsorted(position_px[:, 0], predicted_px[:, 0] - radius_px)
    for k in range(len(predicted_descriptor)):
        best = second = INFINITE_DISTANCE
        winner = -1
        for n in range(begin[k], len(descriptor)):
            dx = position_px[n, 0] - predicted_px[k, 0]
            dy = position_px[n, 1] - predicted_px[k, 1]
            if dx > radius_px:
                break
            if dx * dx + dy * dy > radius_px * radius_px:
                continue
            difference = _squared_distance(predicted_descriptor[k], descriptor[n])
            if difference < best:
                best, second, winner = difference, best, n
            elif difference < second:
                second = difference
            if difference < closest[n]:
                closest[n], closest_to[n] = difference, k
        length = _squared_distance(predicted_descriptor[k], np.zeros_like(predicted_descriptor[k]))
        if best < MAX_DISTANCE_RATIO**2 * second and best <= MAX_RELATIVE_DISTANCE**2 * length:
            nearest[k] = winner
    for k in range(len(predicted_descriptor)):
        if nearest[k] >= 0 and closest_to[nearest[k]] != k:
            nearest[k] = -1
    return nearest


@inline_kernel
def _squared_distance(a: Descriptors, b: Descriptors) -> int:
    total = 0
    for d in range(len(a)):
        step = int(a[d]) - int(b[d])
        total += step * step
    return total
