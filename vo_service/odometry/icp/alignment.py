"""The motion that lays a reference's planes on a frame's surfaces: Gauss-Newton, coarse to fine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import (
    Array,
    inverse,
    orthonormalize,
    rigid_transform,
    rotation_angle_rad,
    so3_exp,
)
from vo_service.odometry.degeneracy import DegeneracyAnalysis, analyze_degeneracy, point_information
from vo_service.odometry.icp.depth_pyramid import DepthPyramid
from vo_service.odometry.icp.residuals import accumulate_normal_equations, robust_cost

PlanePyramid = Sequence[Array]

# The levels to pass through where the motion is well foreseen, and where it is not.
FINE_ONLY, COARSE_TO_FINE = (0,), (2, 1, 0)
# By level, fine to coarse: steps at most, and a step, in metres and radians, that is the last one.
MAX_STEPS = (15, 10, 10)
MIN_STEP_SIZES = (1e-4, 5e-4, 1e-3)
# By level, in 1/m: residuals beyond which a plane is left out, and the spread of the others, which
# is found with the motion. It begins at the most, so that what is far off has a say; were it not
# kept from falling much below the noise, the first surfaces that fit would hold the rest off.
GATES_PER_M = (0.2, 0.2, 0.2)
MAX_SIGMAS_PER_M = (1e-2, 1e-2, 2e-2)
MIN_SIGMAS_PER_M = (1e-3, 2e-3, 4e-3)
# How far from its start a motion may be found; a corner of a room looks like the next one.
MAX_CORRECTION_M, MAX_CORRECTION_RAD = 0.5, 0.5
# Noise of a plane's slopes on the finest level, in 1/m a pixel: the sensor's steps of depth. Times
# the focal length and the plane's distance it is that of the normal. Coarser planes have less, but
# more of them bend: they are trusted no further.
SLOPE_NOISE = 1e-4
# One motion fits clearly better than another if its cost is this share of the other's or less.
MAX_BETTER_COST_RATIO = 0.9
# Fewer planes with a reading are no ground for a step.
MIN_PLANES = 50


@dataclass(frozen=True)
class IcpAlignment:
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
    has_converged: bool
    num_planes: int
    num_with_reading: int
    num_in_gate: int
    num_inliers: int
    sigma: float
    information: Array
    degeneracy: DegeneracyAnalysis


def align(
    planes: PlanePyramid,
    view: DepthPyramid,
    initial_guesses: Sequence[Array],
    levels: Sequence[int],
) -> IcpAlignment:
    """Lay planes, an array for each level, on a frame's surfaces.

    starts  4x4 motions T_camera_reference; it begins at the first, unless another clearly fits
            better
    levels  the levels to pass through, the last of which is the finest, 0
    """
    T = start = _select_best_motion(planes, view, initial_guesses, level=1)
    sigma, has_settled = MIN_SIGMAS_PER_M[0], False
    for level in levels:
        there, sigma, has_settled = _solve_level(planes, view, T, level)
        T = _select_best_motion(planes, view, (T, there), level) if level else there
    has_settled = has_settled and _is_near_guess(T, start)
    return evaluate_alignment(planes, view, orthonormalize(T), sigma, has_settled)


def evaluate_alignment(
    planes: PlanePyramid,
    view: DepthPyramid,
    T_camera_reference: Array,
    sigma: float = MIN_SIGMAS_PER_M[0],
    has_converged: bool = True,
) -> IcpAlignment:
    """How well the planes lie where they are, given the spread to expect."""
    H, _, moments, counts = _build_normal_equations(
        planes, view, T_camera_reference, sigma, level=0
    )
    return IcpAlignment(
        T_camera_reference=T_camera_reference,
        has_converged=has_converged,
        num_planes=len(planes[0]),
        num_with_reading=int(counts[0]),
        num_in_gate=int(counts[1]),
        num_inliers=int(counts[2]),
        sigma=max(_residual_sigma(counts), MIN_SIGMAS_PER_M[0]),
        information=H,
        degeneracy=analyze_degeneracy(H, point_information(moments)),
    )


def _select_best_motion(
    planes: PlanePyramid, view: DepthPyramid, motions: Sequence[Array], level: int
) -> Array:
    """The motion that fits best; the first, if none is better by a tenth."""
    misfits = [_mean_cost(planes, view, T, level) for T in motions]
    best = int(np.argmin(misfits))
    return motions[best] if misfits[best] < MAX_BETTER_COST_RATIO * misfits[0] else motions[0]


def _mean_cost(planes: PlanePyramid, view: DepthPyramid, T: Array, level: int) -> float:
    """Mean robust cost; where fewer than half of the planes are in view, the others count too."""
    sigma, gate = MIN_SIGMAS_PER_M[level], GATES_PER_M[level]
    counts = _build_normal_equations(planes, view, T, sigma, level)[3]
    missing = max(0.0, len(planes[level]) / 2 - counts[0])
    cost = counts[4] + missing * robust_cost(gate / sigma)
    return float(cost / max(counts[0] + missing, 1.0))


def _solve_level(
    planes: PlanePyramid, view: DepthPyramid, T: Array, level: int
) -> tuple[Array, float, bool]:
    """Gauss-Newton on one level: the motion, the spread, and whether the steps came to an end."""
    sigma = MAX_SIGMAS_PER_M[level]
    for _ in range(MAX_STEPS[level]):
        H, g, moments, counts = _build_normal_equations(planes, view, T, sigma, level)
        if counts[1] < MIN_PLANES:
            break
        sigma = float(
            np.clip(_residual_sigma(counts), MIN_SIGMAS_PER_M[level], MAX_SIGMAS_PER_M[level])
        )
        # No step goes where the planes say no more than their noise.
        V = analyze_degeneracy(H, point_information(moments)).observable_axes
        step = -V @ np.linalg.solve(V.T @ H @ V, V.T @ g)
        T = T @ rigid_transform(so3_exp(step[3:]), step[:3])
        if np.max(np.abs(step)) < MIN_STEP_SIZES[level]:
            return T, sigma, True
    return T, sigma, False


def _residual_sigma(counts: Array) -> float:
    """Root of the mean w r^2: the sigma of Student's t, where it no longer changes."""
    return float(np.sqrt(counts[3] / max(counts[1], 1.0)))


def _build_normal_equations(
    planes: PlanePyramid, view: DepthPyramid, T: Array, sigma: float, level: int
) -> tuple[Array, Array, Array, Array]:
    image = view.levels[level]
    gate = GATES_PER_M[level]
    normal_noise = SLOPE_NOISE * view.levels[0].camera.fx
    return accumulate_normal_equations(
        planes[level], T, image.inverse_depth, image.intrinsics, normal_noise, sigma, gate
    )


def _is_near_guess(T: Array, start: Array) -> bool:
    """Whether a motion is near enough to its start to be the one looked for: rooms look alike."""
    way = inverse(start) @ T
    turn_rad = rotation_angle_rad(way[:3, :3])
    return bool(np.linalg.norm(way[:3, 3]) < MAX_CORRECTION_M and turn_rad < MAX_CORRECTION_RAD)
