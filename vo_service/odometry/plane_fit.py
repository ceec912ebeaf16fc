"""Plane fit to the depth around a pixel: on a plane, 1/z is linear in the pixel."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel


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
    n = su = sv = suu = suv = svv = sw = suw = svw = sww = 0.0
    for j in range(-radius, radius + 1):
        dv = j * step
        for i in range(-radius, radius + 1):
            du = i * step
            sample = float(inverse_depth[row + dv, column + du])
            w = sample - center
            if sample <= 0.0 or abs(w) > max_step_per_m:
                continue
            n += 1.0
            su += du
            sv += dv
            suu += du * du
            suv += du * dv
            svv += dv * dv
            sw += w
            suw += du * w
            svw += dv * w
            sww += w * w
    if n < min_support * (2 * radius + 1) ** 2:
        return none
    # Normal equations about the centroid, a 2x2 system for the two slopes.
    mu, mv, mw = su / n, sv / n, sw / n
    cuu, cuv, cvv = suu - n * mu * mu, suv - n * mu * mv, svv - n * mv * mv
    cuw, cvw = suw - n * mu * mw, svw - n * mv * mw
    det = cuu * cvv - cuv * cuv
    if det <= 1e-9:
        return none
    wu = (cuw * cvv - cvw * cuv) / det
    wv = (cvw * cuu - cuw * cuv) / det
    squared = sww - n * mw * mw - wu * cuw - wv * cvw
    return center + mw - wu * mu - wv * mv, wu, wv, squared / n
