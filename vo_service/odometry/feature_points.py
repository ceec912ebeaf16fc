"""Back-projection of features to 3-D points, where their depth is reliable."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.depth_noise import depth_sigma_m, lateral_sigma_m
from vo_service.odometry.gray_frame import GrayFrame
from vo_service.odometry.surf import Features

# A plane is fitted over a square of (2 RADIUS + 1)^2 pixels.
PLANE_RADIUS_PX = 4
# Pixels that differ by more from the center in 1/z belong to another surface.
MAX_STEP_PER_M = 0.02
# The plane covers at least this share of the square.
MIN_PLANE_SUPPORT = 0.6


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


def pair_points(
    points: FeaturePoints, reference: FeaturePoints, pairs: NDArray[np.int64]
) -> PointPairs:
    """Pair the points of matched features (M, 2), all of which have depth."""
    i, j = pairs[:, 0], pairs[:, 1]
    return PointPairs(
        P_camera=points.position_m[i],
        P_reference=reference.position_m[j],
        sigma_across_m=np.hypot(points.sigma_across_m[i], reference.sigma_across_m[j]),
        sigma_along_m=np.hypot(points.sigma_along_m[i], reference.sigma_along_m[j]),
    )


@kernel
def fit_inverse_depth(
    depth_m: NDArray[np.float32], position_px: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Inverse depth (N,) in 1/m at each position, 0 where it is not reliable."""
    height, width = depth_m.shape
    inverse_depth_per_m = np.zeros(len(position_px))
    for n in range(len(position_px)):
        x, y = float(position_px[n, 0]), float(position_px[n, 1])
        column, row = int(x + 0.5), int(y + 0.5)
        if (
            PLANE_RADIUS_PX <= column < width - PLANE_RADIUS_PX
            and PLANE_RADIUS_PX <= row < height - PLANE_RADIUS_PX
        ):
            inverse_depth_per_m[n] = _fit_plane(depth_m, column, row, x - column, y - row)
    return inverse_depth_per_m


@inline_kernel
def _fit_plane(depth_m: NDArray[np.float32], column: int, row: int, dx: float, dy: float) -> float:
    """1/z at (column + dx, row + dy) of the plane 1/z = a + b u + c v around a pixel, or 0."""
    center = depth_m[row, column]
    if center <= 0:
        return 0.0
    w0 = 1.0 / center
    n = su = sv = suu = suv = svv = sw = suw = svw = 0.0
    for v in range(-PLANE_RADIUS_PX, PLANE_RADIUS_PX + 1):
        for u in range(-PLANE_RADIUS_PX, PLANE_RADIUS_PX + 1):
            z = depth_m[row + v, column + u]
            if z <= 0:
                continue
            w = 1.0 / z - w0
            if abs(w) > MAX_STEP_PER_M:
                # A depth edge at the feature itself makes its depth ambiguous.
                if abs(u) <= 1 and abs(v) <= 1:
                    return 0.0
                continue
            n += 1.0
            su += u
            sv += v
            suu += u * u
            suv += u * v
            svv += v * v
            sw += w
            suw += u * w
            svw += v * w
    if n < MIN_PLANE_SUPPORT * (2 * PLANE_RADIUS_PX + 1) ** 2:
        return 0.0
    # Normal equations about the centroid, a 2x2 system for the two slopes.
    mu, mv, mw = su / n, sv / n, sw / n
    cuu, cuv, cvv = suu - n * mu * mu, suv - n * mu * mv, svv - n * mv * mv
    cuw, cvw = suw - n * mu * mw, svw - n * mv * mw
    det = cuu * cvv - cuv * cuv
    if det <= 1e-9:
        return 0.0
    b = (cuw * cvv - cvw * cuv) / det
    c = (cvw * cuu - cuw * cuv) / det
    inverse_depth = w0 + mw + b * (dx - mu) + c * (dy - mv)
    return inverse_depth if inverse_depth > 0 else 0.0
