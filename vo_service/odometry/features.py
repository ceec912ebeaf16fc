"""Features of frames as 3-D points, and their matches.

Features are matched by the nearest descriptor, with a ratio test and a mutual check. Whether the
matches that agree with a motion do so by chance is decided as by Brown and Lowe, "Automatic
Panoramic Image Stitching using Invariant Features", IJCV 74 (2007), Section 3.2.
"""

from dataclasses import dataclass
from math import log
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.depth import fit_inverse_depth
from vo_service.odometry.depth_grid import NO_DEPTH, DepthGrid
from vo_service.odometry.surf import Features
from vo_service.odometry.uncertainty import depth_sigma_m, lateral_sigma_m
from vo_service.types.estimate import TrackingDebug

# Smallest likelihood ratio of a right motion to chance: one in a million tries is right, and one in
# a thousand accepted motions may be wrong.
MIN_LIKELIHOOD_RATIO = 1e6 * 1e3


@dataclass(frozen=True)
class GrayFrame:
    """Brightness and depth of a frame, for features; it needs a third of the frame's memory.

    Attributes:
        gray: (height, width) uint8 brightness.
        depth_raw: (height, width) uint16 as given by the sensor, 0 = no reading.
        depth_factor: Value of `depth_raw` per meter.
        camera: Intrinsics of both images.
        stamp_s: Of the frame.
    """

    gray: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]
    depth_factor: float
    camera: PinholeCamera
    stamp_s: float

    @classmethod
    def of(cls, frame: "RgbdFrame | GrayFrame") -> Self:
        """Share the images of `frame`, except its color."""
        return cls(frame.gray, frame.depth_raw, frame.depth_factor, frame.camera, frame.stamp_s)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 meters; 0 = no reading. Not cached: it is needed once."""
        return self.depth_raw * np.float32(1.0 / self.depth_factor)


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
        view: The view.
        reference: The reference.
        pairs: (M, 2) indices of features of both.
    """
    return pairs[view.points.has_depth[pairs[:, 0]] & reference.points.has_depth[pairs[:, 1]]]


def make_tracking_debug(
    view: FeatureView,
    reference: FeatureView,
    matches: NDArray[np.int64],
    inlier: NDArray[np.bool_],
) -> TrackingDebug:
    """Make the debug data of matches (M, 2), of which (M,) are inliers of a motion.

    Args:
        view: The view.
        reference: The reference.
        matches: (M, 2) indices of features of both.
        inlier: (M,) which matches agree with the motion.
    """
    return TrackingDebug(
        keypoints_px=view.features.position_px,
        matches_px=view.features.position_px[matches[:, 0]],
        reference_matches_px=reference.features.position_px[matches[:, 1]],
        inlier=inlier,
    )


class HasDescriptors(Protocol):
    """Features that can be matched.

    Attributes:
        sign: (N,) of the Laplacian: +1 dark blob, -1 bright blob.
        descriptor: (N, 64) float32 whole numbers.
    """

    @property
    def sign(self) -> NDArray[np.generic]: ...

    @property
    def descriptor(self) -> NDArray[np.float32]: ...


def match_features(
    query: HasDescriptors, reference: HasDescriptors, ratio: float
) -> NDArray[np.int64]:
    """Match features: pairs (M, 2) of indices into `query` and `reference`, sorted by query.

    A pair needs a second nearest descriptor further by 1/ratio (Lowe 2004, Section 7.1), and each
    has to be the other's nearest. Bright and dark blobs are never compared (Bay et al. 2008,
    Section 4.3).

    Args:
        query: Features that are matched.
        reference: Features that they are matched with.
        ratio: Largest ratio of the nearest to the second nearest distance.
    """
    blocks = [np.empty((0, 2), np.int64)]
    for sign in (-1.0, 1.0):
        queries = np.flatnonzero(query.sign == sign)
        references = np.flatnonzero(reference.sign == sign)
        if len(queries) and len(references):
            pairs = match_descriptors(
                query.descriptor[queries], reference.descriptor[references], ratio
            )
            blocks.append(np.column_stack([queries[pairs[:, 0]], references[pairs[:, 1]]]))
    pairs = np.concatenate(blocks)
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def match_descriptors(
    query: NDArray[np.float32], reference: NDArray[np.float32], ratio: float
) -> NDArray[np.int64]:
    """Match descriptors: pairs (M, 2) of rows of `query` (N, D) and `reference` (K, D).

    They are float32 whole numbers: every dot product is exact with any BLAS and thread count.

    Args:
        query: (N, D) descriptors that are matched.
        reference: (K, D) descriptors that they are matched with.
        ratio: Largest ratio of the nearest to the second nearest distance.
    """
    similarity = _similarity(query, reference)
    best, second, nearest = find_best_two(similarity)
    queries = np.flatnonzero(best > ratio**2 * second.astype(np.float64))
    references = nearest[queries]
    is_mutual = similarity.argmax(axis=1)[references] == queries
    return np.column_stack([queries[is_mutual], references[is_mutual]]).astype(np.int64)


def _similarity(query: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float32]:
    """(K, N) table of -|q - r|^2 / 2 = q.r - |r|^2 / 2 - |q|^2 / 2, as one matrix product."""
    half = np.float32(0.5)
    one_q, one_r = np.ones(len(query), np.float32), np.ones(len(reference), np.float32)
    queries = np.vstack([query.T, one_q, -half * np.einsum("nd,nd->n", query, query)])
    references = np.column_stack(
        [reference, -half * np.einsum("kd,kd->k", reference, reference), one_r]
    )
    table: NDArray[np.float32] = references @ queries
    return table


@kernel
def find_best_two(
    similarity: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Per column of a (K, N) table: largest value, second largest, and row of the largest.

    Runs down all columns at once, so that it vectorizes.
    """
    rows, columns = similarity.shape
    best = np.full(columns, np.float32(-np.inf), np.float32)
    second = np.full(columns, np.float32(-np.inf), np.float32)
    nearest = np.zeros(columns, np.int32)
    for r in range(rows):
        row = similarity[r]
        for c in range(columns):
            value, largest = row[c], best[c]
            runner_up = largest if value > largest else value
            second[c] = runner_up if runner_up > second[c] else second[c]
            nearest[c] = np.int32(r) if value > largest else nearest[c]
            best[c] = value if value > largest else largest
    return best, second, nearest


@dataclass(frozen=True)
class MatchVerifier:
    """Test whether enough matches agree with a motion.

    Attributes:
        inlier_share_if_right: Share of matches that agree with a right motion.
        inlier_share_by_chance: Share of matches that agree with a wrong motion.
    """

    inlier_share_if_right: float
    inlier_share_by_chance: float

    def accepts(self, inliers: int, matches: int) -> bool:
        """Whether `inliers` of `matches` are too many for chance."""
        log_ratio_per_inlier = log(self.inlier_share_if_right / self.inlier_share_by_chance)
        log_ratio_per_outlier = log(
            (1.0 - self.inlier_share_if_right) / (1.0 - self.inlier_share_by_chance)
        )
        return inliers * log_ratio_per_inlier + (matches - inliers) * log_ratio_per_outlier > log(
            MIN_LIKELIHOOD_RATIO
        )


@dataclass(frozen=True)
class SurfParameters:
    """Parameters of a motion by features: matching, RANSAC, verification and failures."""

    match_ratio: float = 0.8
    max_hypotheses: int = 500  # per RANSAC run
    min_inliers: int = 15  # fewer pairs agree by chance
    # Share of the visible depth that a motion contradicts, if a minority of the matches agrees with
    # it. Right motions: more is contradicted by 0.03 % (of 17,200 in 19 recordings), and over up to
    # 10 frames by 0.4 % where a person walks past. Wrong ones: by 96 % if by 0.1 m and 10 degrees,
    # 99 % if by 0.3 m and 30 degrees, and 76 % if they slide and turn along the largest plane.
    max_depth_contradiction: float = 0.3
    # A motion whose three sigmas exceed either of these is in doubt.
    max_error_m: float = 0.05
    max_error_rad: float = 0.05
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose
    seed: int = 1  # of RANSAC, the same for every run
