"""Small planes on the surfaces of a depth image, and a choice of them that faces all ways."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.icp.depth_pyramid import DepthLevel
from vo_service.odometry.plane_fit import fit_plane

# A plane is fitted over a square of (2 RADIUS + 1)^2 pixels, ...
PLANE_RADIUS_PX = 3
# ... around every so-manieth pixel across and down, ...
GRID_STEP_PX = 3
# ... over readings that lie within this much of the middle's in 1/z: beyond is another surface.
MAX_STEP_PER_M = 0.03
# They cover at least this share of the square, ...
MIN_PLANE_SUPPORT = 0.6
# ... and lie this near to the plane, root mean square in 1/m, at half the sensor's size: thrice
# the noise. Smaller images, whose readings are means of more, have less noise.
MAX_RMS_PER_M = 4e-3
# A surface seen nearly edge-on has no reliable plane: smallest cosine of the angle to the ray.
MIN_COSINE = 0.15
# Columns of a plane: its point (x, y, z), its normal (away from the camera), and its distance.
NUM_COLUMNS = 7


def find_planes(level: DepthLevel, max_planes: int) -> Array:
    """(N, 7) planes in the camera's axes: point x, y, z (m), unit normal, distance n.p (m).

    Of all that are found, at most `budget`, chosen so that rare directions of normals are not
    lost among common ones: normal-space sampling (Rusinkiewicz and Levoy 2001, Section 3.2).
    """
    max_rms_per_m = MAX_RMS_PER_M * np.sqrt(2.0 / level.scale)
    planes = fit_planes(level.inverse_depth, level.intrinsics, float(max_rms_per_m))
    return planes[sample_balanced(normal_bins(planes), max_planes)]


def normal_bins(planes: Array) -> NDArray[np.int64]:
    """(N,) in which of 18 ranges each normal lies: 25 degrees off the ray wide, 60 around it."""
    aside = np.clip(np.degrees(np.arccos(np.clip(planes[:, 5], -1.0, 1.0))) // 25, 0, 2)
    around = np.clip(np.degrees(np.arctan2(planes[:, 4], planes[:, 3]) + np.pi) // 60, 0, 5)
    bins: NDArray[np.int64] = (6 * aside + around).astype(np.int64)
    return bins


def sample_balanced(bins: NDArray[np.int64], max_members: int) -> NDArray[np.int64]:
    """Rising indices of at most `budget` members: all of small bins, evenly spread ones of large.

    bins  (N,) the bin that each member lies in
    """
    if len(bins) <= max_members:
        return np.arange(len(bins))
    counts = np.bincount(bins)
    cap = _find_cap(counts, max_members)
    members = [np.flatnonzero(bins == each) for each in np.flatnonzero(counts)]
    return np.sort(np.concatenate([_select_evenly(each, cap) for each in members]))


def _find_cap(counts: NDArray[np.int64], max_members: int) -> int:
    """The most that each bin may give so that all give no more than `budget`."""
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
    """(N, 7) planes on a grid over an image; see `find_planes`. intrinsics: fx, fy, cx, cy."""
    height, width = inverse_depth.shape
    fx, fy, cx, cy = intrinsics
    most = (height // GRID_STEP_PX + 1) * (width // GRID_STEP_PX + 1)
    planes = np.empty((most, NUM_COLUMNS))
    found = 0
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
            planes[found] = (x, y, z, a * distance, b * distance, c * distance, distance)
            found += 1
    return planes[:found]
