"""Planes fitted to a depth image, sampled so that all directions of normals are present."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.depth_planes import fit_plane
from vo_service.odometry.icp.depth_pyramid import DepthLevel

# A plane is fitted over a square of (2 RADIUS + 1)^2 pixels.
PLANE_RADIUS_PX = 3
# Distance of the squares' centers.
GRID_STEP_PX = 3
# Readings that differ by more from the center in 1/z belong to another surface.
MAX_STEP_PER_M = 0.03
# Smallest share of the square on the plane.
MIN_PLANE_SUPPORT = 0.6
# Largest root mean square residual in 1/m, at half the sensor's size: three times the noise.
# Smaller images average more readings and have less noise.
MAX_RMS_PER_M = 4e-3
# Smallest cosine of the angle between normal and ray: at grazing angles a plane is not reliable.
MIN_COSINE = 0.15
# Columns of a plane: its point (x, y, z), its normal (away from the camera), and its distance.
NUM_COLUMNS = 7


def find_planes(level: DepthLevel, max_planes: int) -> Array:
    """Find at most `max_planes` planes in a depth image.

    They are sampled by their normals, so that rare directions are kept: normal-space sampling
    (Rusinkiewicz and Levoy 2001, Section 3.2).

    Returns:
        (N, 7) in the camera's axes: point x, y, z (m), unit normal, distance n.p (m).
    """
    max_rms_per_m = MAX_RMS_PER_M * np.sqrt(2.0 / level.scale)
    planes = fit_planes(level.inverse_depth, level.intrinsics, float(max_rms_per_m))
    return planes[sample_balanced(normal_bins(planes), max_planes)]


def normal_bins(planes: Array) -> NDArray[np.int64]:
    """(N,) which of 18 bins each normal lies in: 25 degrees off the axis, 60 around it."""
    off_axis = np.clip(np.degrees(np.arccos(np.clip(planes[:, 5], -1.0, 1.0))) // 25, 0, 2)
    around_axis = np.clip(np.degrees(np.arctan2(planes[:, 4], planes[:, 3]) + np.pi) // 60, 0, 5)
    bins: NDArray[np.int64] = (6 * off_axis + around_axis).astype(np.int64)
    return bins


def sample_balanced(bins: NDArray[np.int64], max_members: int) -> NDArray[np.int64]:
    """Sample at most `max_members`: all of small bins, an even selection of large ones.

    Args:
        bins: (N,) the bin of each member.
        max_members: Largest number of members.

    Returns:
        Ascending indices of the members.
    """
    if len(bins) <= max_members:
        return np.arange(len(bins))
    counts = np.bincount(bins)
    cap = _find_cap(counts, max_members)
    members = [np.flatnonzero(bins == each) for each in np.flatnonzero(counts)]
    return np.sort(np.concatenate([_select_evenly(each, cap) for each in members]))


def _find_cap(counts: NDArray[np.int64], max_members: int) -> int:
    """Largest number per bin so that the total is at most `max_members`."""
    caps = np.arange(1, max_members + 1)
    totals = np.minimum(counts[:, None], caps).sum(axis=0)
    return int(np.searchsorted(totals, max_members, side="right"))


def _select_evenly(members: NDArray[np.int64], cap: int) -> NDArray[np.int64]:
    count = min(len(members), cap)
    return members[np.arange(count) * len(members) // max(count, 1)]


@kernel
def fit_planes(
    inverse_depth: NDArray[np.float32], intrinsics: Array, max_rms_per_m: float
) -> Array:
    """(N, 7) planes on a grid over an image; see `find_planes`. intrinsics: fx, fy, cx, cy.

    Args:
        inverse_depth: (H, W), 1/m; 0 = no reading.
        intrinsics: (4,) fx, fy, cx, cy.
        max_rms_per_m: Largest root mean square residual of a plane, 1/m.
    """
    height, width = inverse_depth.shape
    fx, fy, cx, cy = intrinsics
    max_planes = (height // GRID_STEP_PX + 1) * (width // GRID_STEP_PX + 1)
    planes = np.empty((max_planes, NUM_COLUMNS))
    count = 0
    for v in range(PLANE_RADIUS_PX, height - PLANE_RADIUS_PX, GRID_STEP_PX):
        for u in range(PLANE_RADIUS_PX, width - PLANE_RADIUS_PX, GRID_STEP_PX):
            w, wu, wv, squared = fit_plane(
                inverse_depth, u, v, PLANE_RADIUS_PX, 1, MAX_STEP_PER_M, MIN_PLANE_SUPPORT
            )
            if w <= 0.0 or squared > max_rms_per_m**2:
                continue
            # On the plane, 1/z = a x/z + b y/z + c, that is (a, b, c) . p = 1.
            a, b = wu * fx, wv * fy
            c = w - wu * (u - cx) - wv * (v - cy)
            distance = 1.0 / np.sqrt(a * a + b * b + c * c)
            x, y, z = (u - cx) / (fx * w), (v - cy) / (fy * w), 1.0 / w
            if distance < MIN_COSINE * np.sqrt(x * x + y * y + z * z):
                continue
            planes[count] = (x, y, z, a * distance, b * distance, c * distance, distance)
            count += 1
    return planes[:count]
