"""Essential matrix by RANSAC, and its motion with the points in front of both cameras.

Longuet-Higgins, "A computer algorithm for reconstructing a scene from two projections", Nature 293
(1981); five points a hypothesis: Nistér, "An efficient solution to the five-point relative pose
problem", PAMI 26 (2004); the four motions: Hartley and Zisserman, "Multiple View Geometry", 2nd
edition, Section 9.6.

Points are triangulated as inverse depths along the rays of the reference, as the error of an
inverse depth is about Gaussian down to no parallax at all (Civera, Davison and Montiel, "Inverse
Depth Parametrization for Monocular SLAM", T-RO 24, 2008).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, rotation_angle_rad
from vo_service.odometry.sfm.mono_frame import RayPairs


@dataclass(frozen=True)
class TriangulatedPoints:
    """Points triangulated by a motion between two views.

    Attributes:
        inverse_depth: (M,) in the reference; negative where the rays meet behind a camera.
        parallax_rad: (M,) approximate angle between the rays at the point.
    """

    inverse_depth: Array
    parallax_rad: Array


def triangulate(R: Array, t: Array, pairs: RayPairs) -> TriangulatedPoints:
    """Triangulate by least squares in the camera's image, with P_camera = R P_reference + t.

    With q = R ray_reference and inverse depth w the point is (q + w t) / w. The camera's ray
    (x, y, 1) gives the equation w (t_xy - t_z (x, y)) = q_z (x, y) - q_xy.

    Args:
        R: 3x3 rotation from the reference's axes to the camera's.
        t: (3,) translation.
        pairs: Rays in the camera and in the reference.
    """
    q = pairs.ray_reference @ R.T
    along = t[:2] - pairs.ray[:, :2] * t[2]
    moved = pairs.ray[:, :2] * q[:, 2:] - q[:, :2]
    squared = np.einsum("ni,ni->n", along, along)
    inverse_depth = np.einsum("ni,ni->n", along, moved) / np.maximum(squared, 1e-18)
    is_behind = q[:, 2] + inverse_depth * t[2] <= 0.0
    inverse_depth[is_behind] = -1.0
    parallax_rad = np.arctan(np.abs(inverse_depth) * np.sqrt(squared))
    parallax_rad[is_behind] = 0.0
    return TriangulatedPoints(inverse_depth, parallax_rad)


# Gate of a pair's distance from its epipolar line, in standard deviations.
GATE_SIGMAS = 1.5
MAX_HYPOTHESES = 1000
CONFIDENCE = 0.9999
# Fewest pairs: five are needed for a hypothesis.
MIN_PAIRS = 8
# No camera turns further between two frames. The false solution always does, as it differs from the
# right one by half a turn.
MAX_ROTATION_RAD = np.pi / 2


@dataclass(frozen=True)
class EssentialMatrix:
    """E with ray^T E ray_reference = 0, and the pairs (M,) that agree with it."""

    E: Array
    inlier: NDArray[np.bool_]


@dataclass(frozen=True)
class UnscaledMotion:
    """Motion up to its scale: P_camera = R P_reference + scale * t.

    Attributes:
        R: 3x3 from the reference's axes to the camera's.
        t: (3,) of length 1.
        inlier: (M,) pairs that agree.
    """

    R: Array
    t: Array
    inlier: NDArray[np.bool_]


def find_unscaled_motion(pairs: RayPairs, seed: int) -> UnscaledMotion | None:
    """Find the motion up to scale that most pairs agree with; None if there is none."""
    essential = find_essential(pairs, seed)
    return None if essential is None else recover_unscaled_motion(essential, pairs)


def find_essential(pairs: RayPairs, seed: int) -> EssentialMatrix | None:
    """Find the essential matrix that most pairs agree with; None if there is none.

    OpenCV's USAC with the five-point solver, scored as in MSAC (Torr and Zisserman 2000). It has
    its own random generator: the same pairs give the same matrix.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    K, no_distortion = np.eye(3), np.zeros(5)
    try:
        E, mask = cv2.findEssentialMat(
            np.ascontiguousarray(pairs.ray_reference[:, :2]),
            np.ascontiguousarray(pairs.ray[:, :2]),
            K, K, no_distortion, no_distortion, _usac_params(GATE_SIGMAS * pairs.sigma, seed),
        )  # fmt: skip
    except cv2.error:  # no five of the pairs make a hypothesis
        return None
    if E is None or E.shape != (3, 3) or not np.isfinite(E).all():
        return None
    return EssentialMatrix(np.asarray(E, np.float64), np.asarray(mask).ravel() > 0)


def _usac_params(threshold: float, seed: int) -> cv2.UsacParams:
    usac = cv2.UsacParams()
    usac.confidence = CONFIDENCE
    usac.isParallel = False
    usac.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    usac.maxIterations = MAX_HYPOTHESES
    usac.randomGeneratorState = seed
    usac.sampler = cv2.SAMPLING_UNIFORM
    usac.score = cv2.SCORE_METHOD_MSAC
    usac.threshold = threshold
    return usac


def recover_unscaled_motion(essential: EssentialMatrix, pairs: RayPairs) -> UnscaledMotion | None:
    """Find the motion with most points in front of both cameras (cheirality), if any.

    Without parallax t is arbitrary, but R is right.
    """
    R1, R2, t = cv2.decomposeEssentialMat(essential.E)
    inlier_pairs = pairs.select(essential.inlier)
    best, max_in_front = None, -1
    for R in (np.asarray(R, np.float64) for R in (R1, R2)):
        if rotation_angle_rad(R) > MAX_ROTATION_RAD:
            continue
        for sign in (1.0, -1.0):
            motion = UnscaledMotion(R, sign * np.asarray(t, np.float64).ravel(), essential.inlier)
            in_front = int((triangulate(R, motion.t, inlier_pairs).inverse_depth > 0.0).sum())
            if in_front > max_in_front:
                best, max_in_front = motion, in_front
    return best
