"""Planes fitted to the depth image; on a plane, 1/z is linear in the pixel."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel

# The plane around a feature is fitted over a square of (2 RADIUS + 1)^2 pixels.
PLANE_RADIUS_PX = 4
# Pixels that differ by more from the center in 1/z belong to another surface.
MAX_STEP_PER_M = 0.02
# The plane covers at least this share of the square.
MIN_PLANE_SUPPORT = 0.6
# Of the normal equations of a plane, px^4; below it the pixels lie on a line.
MIN_DETERMINANT = 1e-9


@inline_kernel
def fit_plane(
    inverse_depth: NDArray[np.float32],
    column: int,
    row: int,
    radius: int,
    step: int,
    max_step_per_m: float,
    min_support: float,
) -> tuple[float, float, float, float]:
    """Fit a plane 1/z = w + wu du + wv dv around a pixel.

    Args:
        inverse_depth: (H, W), 1/m; 0 = no reading.
        column: Center of the square, which lies inside of the image.
        row: See column.
        radius: The square has (2 radius + 1)^2 samples.
        step: Distance of the samples, pixels.
        max_step_per_m: Samples that differ by more from the center belong to another surface.
        min_support: Smallest share of the samples on the plane.

    Returns:
        w, wu, wv (1/m) and the mean squared residual; all 0 if there is no plane.
    """
    none = (0.0, 0.0, 0.0, 0.0)
    center = float(inverse_depth[row, column])
    if center <= 0.0:
        return none
    # Without branches; the sums without w are of integers.
    count = su = sv = suu = suv = svv = 0
    sw = suw = svw = sww = 0.0
    for j in range(-radius, radius + 1):
        dv, in_row, su_row = j * step, 0, 0
        for i in range(-radius, radius + 1):
            du = i * step
            sample = float(inverse_depth[row + dv, column + du])
            w = sample - center
            is_same_surface = (sample > 0.0) & (abs(w) <= max_step_per_m)
            w = w if is_same_surface else 0.0
            in_row += 1 if is_same_surface else 0
            su_row += du if is_same_surface else 0
            suu += du * du if is_same_surface else 0
            sw += w
            suw += du * w
            svw += dv * w
            sww += w * w
        count += in_row
        su += su_row
        sv += dv * in_row
        suv += dv * su_row
        svv += dv * dv * in_row
    n = float(count)
    if n < min_support * (2 * radius + 1) ** 2:
        return none
    # Normal equations about the centroid, a 2x2 system for the two slopes.
    mu, mv, mw = su / n, sv / n, sw / n
    cuu, cuv, cvv = suu - n * mu * mu, suv - n * mu * mv, svv - n * mv * mv
    cuw, cvw = suw - n * mu * mw, svw - n * mv * mw
    det = cuu * cvv - cuv * cuv
    if det <= MIN_DETERMINANT:
        return none
    wu = (cuw * cvv - cvw * cuv) / det
    wv = (cvw * cuu - cuw * cuv) / det
    squared = sww - n * mw * mw - wu * cuw - wv * cvw
    return center + mw - wu * mu - wv * mv, wu, wv, squared / n


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
            inverse_depth_per_m[n] = _fit_feature_plane(depth_m, column, row, x - column, y - row)
    return inverse_depth_per_m


@inline_kernel
def _fit_feature_plane(
    depth_m: NDArray[np.float32], column: int, row: int, dx: float, dy: float
) -> float:
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
    if det <= MIN_DETERMINANT:
        return 0.0
    b = (cuw * cvv - cvw * cuv) / det
    c = (cvw * cuu - cuw * cuv) / det
    inverse_depth = w0 + mw + b * (dx - mu) + c * (dy - mv)
    return inverse_depth if inverse_depth > 0 else 0.0
