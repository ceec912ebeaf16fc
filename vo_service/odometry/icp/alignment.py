"""The motion that lays a reference's planes on a frame's surfaces: Gauss-Newton, coarse to fine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.geometry import (
    Array,
    inverse,
    orthonormal,
    rigid_transform,
    rotation_angle_rad,
    rotation_from_vector,
)
from vo_service.odometry.directions import Directions, directions, point_information
from vo_service.odometry.icp.pyramid import DepthPyramid
from vo_service.odometry.icp.residuals import robust_cost, sum_system

Planes = Sequence[Array]

# The levels to pass through where the motion is well foreseen, and where it is not.
FINE_ALONE, COARSE_TO_FINE = (0,), (2, 1, 0)
# By level, fine to coarse: steps at most, and a step, in metres and radians, that is the last one.
STEPS = (15, 10, 10)
LAST_STEPS = (1e-4, 5e-4, 1e-3)
# By level, in 1/m: residuals beyond which a plane is left out, and the spread of the others, which
# is found with the motion. It begins at the most, so that what is far off has a say; were it not
# kept from falling much below the noise, the first surfaces that fit would hold the rest off.
GATES_PER_M = (0.2, 0.2, 0.2)
MOST_SIGMA = (1e-2, 1e-2, 2e-2)
LEAST_SIGMA = (1e-3, 2e-3, 4e-3)
# How far from its start a motion may be found; a corner of a room looks like the next one.
FARTHEST_M, FARTHEST_RAD = 0.5, 0.5
# Noise of a plane's slopes on the finest level, in 1/m a pixel: the sensor's steps of depth. Times
# the focal length and the plane's distance it is that of the normal. Coarser planes have less, but
# more of them bend: they are trusted no further.
SLOPE_NOISE = 1e-4
# One motion fits clearly better than another if its cost is this share of the other's or less.
CLEARLY = 0.9
# Fewer planes with a reading are no ground for a step.
FEWEST_PLANES = 50


@dataclass(frozen=True)
class Alignment:
    """Where the planes came to lie, judged on the finest level.

    T_camera_reference  4x4
    has_settled         whether the last step was as small as it is to be, not far from the start
    planes              how many there are
    read                how many of them come to lie on readings
    seen                how many of these are near enough to be of the same surface
    agreeing            how many are off by no more than noise
    sigma               spread of the residuals of those seen, 1/m; never less than the usual
    information         6x6, of a small motion (translation m, rotation rad) of the reference's
                        points in its own axes, for residuals of unit spread
    directions          which directions of that motion it settles
    """

    T_camera_reference: Array
    has_settled: bool
    planes: int
    read: int
    seen: int
    agreeing: int
    sigma: float
    information: Array
    directions: Directions


def align(
    planes: Planes, view: DepthPyramid, starts: Sequence[Array], levels: Sequence[int]
) -> Alignment:
    """Lay planes, an array for each level, on a frame's surfaces.

    starts  4x4 motions T_camera_reference; it begins at the first, unless another clearly fits
            better
    levels  the levels to pass through, the last of which is the finest, 0
    """
    T = start = _likeliest(planes, view, starts, level=1)
    sigma, has_settled = LEAST_SIGMA[0], False
    for level in levels:
        there, sigma, has_settled = _descend(planes, view, T, level)
        T = _likeliest(planes, view, (T, there), level) if level else there
    has_settled = has_settled and _is_near(T, start)
    return measure(planes, view, orthonormal(T), sigma, has_settled)


def measure(
    planes: Planes,
    view: DepthPyramid,
    T_camera_reference: Array,
    sigma: float = LEAST_SIGMA[0],
    has_settled: bool = True,
) -> Alignment:
    """How well the planes lie where they are, given the spread to expect."""
    H, _, moments, counts = _system(planes, view, T_camera_reference, sigma, level=0)
    return Alignment(
        T_camera_reference=T_camera_reference,
        has_settled=has_settled,
        planes=len(planes[0]),
        read=int(counts[0]),
        seen=int(counts[1]),
        agreeing=int(counts[2]),
        sigma=max(_spread(counts), LEAST_SIGMA[0]),
        information=H,
        directions=directions(H, point_information(moments)),
    )


def _likeliest(planes: Planes, view: DepthPyramid, motions: Sequence[Array], level: int) -> Array:
    """The motion that fits best; the first, if none is better by a tenth."""
    misfits = [_misfit(planes, view, T, level) for T in motions]
    best = int(np.argmin(misfits))
    return motions[best] if misfits[best] < CLEARLY * misfits[0] else motions[0]


def _misfit(planes: Planes, view: DepthPyramid, T: Array, level: int) -> float:
    """Mean robust cost; where fewer than half of the planes are in view, the others count too."""
    sigma, gate = LEAST_SIGMA[level], GATES_PER_M[level]
    counts = _system(planes, view, T, sigma, level)[3]
    missing = max(0.0, len(planes[level]) / 2 - counts[0])
    cost = counts[4] + missing * robust_cost(gate / sigma)
    return float(cost / max(counts[0] + missing, 1.0))


def _descend(planes: Planes, view: DepthPyramid, T: Array, level: int) -> tuple[Array, float, bool]:
    """Gauss-Newton on one level: the motion, the spread, and whether the steps came to an end."""
    sigma = MOST_SIGMA[level]
    for _ in range(STEPS[level]):
        H, g, moments, counts = _system(planes, view, T, sigma, level)
        if counts[1] < FEWEST_PLANES:
            break
        sigma = float(np.clip(_spread(counts), LEAST_SIGMA[level], MOST_SIGMA[level]))
        # No step goes where the planes say no more than their noise.
        V = directions(H, point_information(moments)).known
        step = -V @ np.linalg.solve(V.T @ H @ V, V.T @ g)
        T = T @ rigid_transform(rotation_from_vector(step[3:]), step[:3])
        if np.max(np.abs(step)) < LAST_STEPS[level]:
            return T, sigma, True
    return T, sigma, False


def _spread(counts: Array) -> float:
    """Root of the mean w r^2: the sigma of Student's t, where it no longer changes."""
    return float(np.sqrt(counts[3] / max(counts[1], 1.0)))


def _system(
    planes: Planes, view: DepthPyramid, T: Array, sigma: float, level: int
) -> tuple[Array, Array, Array, Array]:
    image = view.levels[level]
    gate = GATES_PER_M[level]
    normal_noise = SLOPE_NOISE * view.levels[0].camera.fx
    return sum_system(
        planes[level], T, image.inverse_depth, image.intrinsics, normal_noise, sigma, gate
    )


def _is_near(T: Array, start: Array) -> bool:
    """Whether a motion is near enough to its start to be the one looked for: rooms look alike."""
    way = inverse(start) @ T
    turn_rad = rotation_angle_rad(way[:3, :3])
    return bool(np.linalg.norm(way[:3, 3]) < FARTHEST_M and turn_rad < FARTHEST_RAD)
