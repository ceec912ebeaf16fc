"""Alignment of a reference's planes with a frame's surfaces: Gauss-Newton, coarse to fine."""

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
from vo_service.odometry.icp.depth_pyramid import DepthPyramid
from vo_service.odometry.icp.residuals import accumulate_normal_equations, robust_cost
from vo_service.odometry.uncertainty import (
    DegeneracyAnalysis,
    analyze_degeneracy,
    point_information,
)

PlanePyramid = Sequence[Array]

# Levels for a well predicted motion, and for any other.
FINE_ONLY, COARSE_TO_FINE = (0,), (2, 1, 0)
# By level, fine to coarse: largest number of steps; a smaller step (m and rad) is the last one.
MAX_STEPS = (15, 10, 10)
MIN_STEP_SIZES = (1e-4, 5e-4, 1e-3)
# By level, in 1/m: the gate of a residual, and the range of its sigma, which is estimated with the
# motion. Sigma starts at the maximum, so that large residuals count. The minimum is near the noise;
# below it the first surfaces that fit would suppress the others.
GATES_PER_M = (0.2, 0.2, 0.2)
MAX_SIGMAS_PER_M = (1e-2, 1e-2, 2e-2)
MIN_SIGMAS_PER_M = (1e-3, 2e-3, 4e-3)
# Largest correction of the initial guess; corners of a room look alike.
MAX_CORRECTION_M, MAX_CORRECTION_RAD = 0.5, 0.5
# Noise of a plane's slopes on the finest level, in 1/m per pixel: the sensor's depth quantization.
# Times the focal length and the plane's distance it is that of the normal. Coarser planes have less
# noise, but more of them are bent, so the same value is used.
SLOPE_NOISE = 1e-4
# One motion fits clearly better than another if its cost is less than this share of the other's.
MAX_BETTER_COST_RATIO = 0.9
# Fewest planes in the gate for a step.
MIN_PLANES = 50


@dataclass(frozen=True)
class IcpAlignment:
    """Alignment of the planes with a frame, evaluated on the finest level.

    Attributes:
        T_camera_reference: 4x4.
        has_converged: Whether the last step was small, and the motion is near the initial guess.
        num_planes: Number of planes.
        num_with_reading: Planes that project to a depth reading.
        num_in_gate: Of these, planes near enough to be of the same surface.
        num_inliers: Planes with a residual within the noise.
        sigma: Of the residuals in the gate, 1/m; at least the minimum.
        information: 6x6 of a small motion (translation m, rotation rad) of the reference's points
            in its own axes, for residuals of sigma 1.
        degeneracy: Which directions of that motion are constrained.
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
    """Align planes with a frame's surfaces.

    Args:
        planes: (N, 7) for each level, see `find_planes`.
        view: The frame.
        initial_guesses: 4x4 motions T_camera_reference; the first one is refined, unless another
            fits clearly better.
        levels: Levels in their order; the last one is the finest, 0.
    """
    T = initial = _select_best_motion(planes, view, initial_guesses, level=1)
    sigma, has_converged = MIN_SIGMAS_PER_M[0], False
    for level in levels:
        solved, sigma, has_converged = _solve_level(planes, view, T, level)
        T = _select_best_motion(planes, view, (T, solved), level) if level else solved
    has_converged = has_converged and _is_near_guess(T, initial)
    return evaluate_alignment(planes, view, orthonormalize(T), sigma, has_converged)


def evaluate_alignment(
    planes: PlanePyramid,
    view: DepthPyramid,
    T_camera_reference: Array,
    sigma: float = MIN_SIGMAS_PER_M[0],
    has_converged: bool = True,
) -> IcpAlignment:
    """Evaluate the alignment at a given motion, with the expected sigma of the residuals.

    Args:
        planes: Of the reference, for each level.
        view: The frame.
        T_camera_reference: 4x4 motion.
        sigma: Expected sigma of the residuals, 1/m.
        has_converged: Whether the steps to that motion have converged.
    """
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
    """The motion that fits best; the first one unless another is clearly better."""
    costs = [_mean_cost(planes, view, T, level) for T in motions]
    best = int(np.argmin(costs))
    return motions[best] if costs[best] < MAX_BETTER_COST_RATIO * costs[0] else motions[0]


def _mean_cost(planes: PlanePyramid, view: DepthPyramid, T: Array, level: int) -> float:
    """Mean robust cost; if fewer than half of the planes are in view, missing ones count."""
    sigma, gate = MIN_SIGMAS_PER_M[level], GATES_PER_M[level]
    counts = _build_normal_equations(planes, view, T, sigma, level)[3]
    missing = max(0.0, len(planes[level]) / 2 - counts[0])
    cost = counts[4] + missing * robust_cost(gate / sigma)
    return float(cost / max(counts[0] + missing, 1.0))


def _solve_level(
    planes: PlanePyramid, view: DepthPyramid, T: Array, level: int
) -> tuple[Array, float, bool]:
    """Gauss-Newton on one level: the motion, the sigma, and whether it converged."""
    sigma = MAX_SIGMAS_PER_M[level]
    for _ in range(MAX_STEPS[level]):
        H, g, moments, counts = _build_normal_equations(planes, view, T, sigma, level)
        if counts[1] < MIN_PLANES:
            break
        sigma = float(
            np.clip(_residual_sigma(counts), MIN_SIGMAS_PER_M[level], MAX_SIGMAS_PER_M[level])
        )
        # No step is taken along unconstrained directions.
        V = analyze_degeneracy(H, point_information(moments)).observable_axes
        step = -V @ np.linalg.solve(V.T @ H @ V, V.T @ g)
        T = T @ rigid_transform(so3_exp(step[3:]), step[:3])
        if np.max(np.abs(step)) < MIN_STEP_SIZES[level]:
            return T, sigma, True
    return T, sigma, False


def _residual_sigma(counts: Array) -> float:
    """Root of the mean w r^2: sigma of Student's t at its fixed point."""
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


def _is_near_guess(T: Array, initial: Array) -> bool:
    """Whether a motion is near its initial guess."""
    correction = inverse(initial) @ T
    angle_rad = rotation_angle_rad(correction[:3, :3])
    return bool(
        np.linalg.norm(correction[:3, 3]) < MAX_CORRECTION_M and angle_rad < MAX_CORRECTION_RAD
    )
