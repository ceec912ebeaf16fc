"""Motion by matched features, and its verification: rejection, or a covariance that covers doubt.

A motion is rejected if its matches may agree by chance, or if they are a minority that contradicts
the depth images. It is in doubt if its inliers do not represent the matches: half of all matches
lie far away, or many of them agree with another motion (that of a moving object, or of the room
behind it).
"""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import Array, inverse, so3_log, transform_points
from vo_service.odometry.features.match_verifier import MatchVerifier
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import PointPairs
from vo_service.odometry.features.views import FeatureView
from vo_service.odometry.ransac import RigidMotionEstimate, find_consensus, refine_rigid_motion
from vo_service.types.odometry import NullStageTimer, StageTimer

# Of a covariance: an error beyond so many standard deviations is not expected.
MAX_SIGMAS = 3.0
# Another motion is as likely if it has this share of the motion's inliers.
MIN_RIVAL_SHARE = 0.5
# Enough to find a motion that a third of the pairs agree with.
RIVAL_HYPOTHESES = 100


def estimate_motion(
    pairs: PointPairs, parameters: SurfParameters, timer: StageTimer | None = None
) -> RigidMotionEstimate:
    """Estimate the motion that most pairs agree with, by RANSAC, and refine it by all of these.

    Args:
        pairs: Points of matched features.
        parameters: Of the search.
        timer: Times the stages "ransac" and "svd"; not timed if None.
    """
    timer = timer or NullStageTimer()
    with timer.stage("ransac"):
        consensus = find_consensus(pairs, parameters.max_hypotheses, parameters.seed)
    with timer.stage("svd"):
        return refine_rigid_motion(consensus, pairs)


def is_beyond_chance(
    motion: RigidMotionEstimate, verifier: MatchVerifier, parameters: SurfParameters
) -> bool:
    """Whether more matches agree with a motion than by chance.

    Args:
        motion: The motion; `inlier` has an entry for each match.
        verifier: For matches of this kind.
        parameters: Limits.
    """
    inliers = int(motion.inlier.sum())
    return inliers >= parameters.min_inliers and verifier.accepts(inliers, len(motion.inlier))


def cover_doubt(
    motion: RigidMotionEstimate, pairs: PointPairs, parameters: SurfParameters
) -> RigidMotionEstimate:
    """Increase the covariance by what the pairs that are no inliers say.

    Args:
        motion: The motion, with the covariance of the fit to its inliers.
        pairs: All pairs, also those that are no inliers.
        parameters: Of the search for another motion.
    """
    covariance = motion.covariance * _median_distance(motion, pairs) ** 2
    rival = _find_rival(motion, pairs, parameters)
    if rival is not None:
        T_camera_rival = inverse(motion.T_reference_camera) @ rival
        difference = np.concatenate([T_camera_rival[:3, 3], so3_log(T_camera_rival[:3, :3])])
        covariance = covariance + np.outer(difference, difference)
    return replace(motion, covariance=covariance)


def _median_distance(motion: RigidMotionEstimate, pairs: PointPairs) -> float:
    """Median distance of all pairs in standard deviations, at least 1.

    It is 1.5 for independent errors of the expected size. It grows with the sensor's true noise,
    and if most pairs contradict the inliers. After Rousseeuw, "Least Median of Squares Regression",
    JASA 79 (1984), where it is the scale of the residuals.
    """
    if not len(pairs):
        return 1.0
    difference_m = transform_points(motion.T_reference_camera, pairs.P_camera) - pairs.P_reference
    x, y, z = difference_m.T
    squares = (x**2 + y**2) / pairs.sigma_across_m**2 + (z / pairs.sigma_along_m) ** 2
    return max(1.0, float(np.sqrt(np.median(squares))))


def _find_rival(
    motion: RigidMotionEstimate, pairs: PointPairs, parameters: SurfParameters
) -> Array | None:
    """Find a 4x4 motion of many of the pairs that are no inliers; None if there is none."""
    min_inliers = max(parameters.min_inliers, MIN_RIVAL_SHARE * motion.inlier.sum())
    others = pairs.select(~motion.inlier)
    if len(others) < min_inliers:
        return None
    consensus = find_consensus(others, RIVAL_HYPOTHESES, parameters.seed)
    if consensus.inlier.sum() < min_inliers:
        return None
    return refine_rigid_motion(consensus, others).T_reference_camera


def rejection_reason(
    view: FeatureView,
    reference: FeatureView,
    motion: RigidMotionEstimate,
    verifier: MatchVerifier,
    parameters: SurfParameters,
) -> str:
    """Why a motion is not believed; "" if it is.

    Depth does not overrule a majority of the matches: it also contradicts a right motion where
    something large moves before the camera.

    Args:
        reference: The view that it was matched with.
        motion: The motion between them; `inlier` has an entry for each match.
        verifier: For matches of this kind.
        parameters: Limits.
    """
    inliers, matches = int(motion.inlier.sum()), len(motion.inlier)
    if not is_beyond_chance(motion, verifier, parameters):
        return f"only {inliers} of {matches} matches agree: may be chance"
    if 2 * inliers >= matches:
        return ""
    contradiction = view.depth.contradiction(reference.depth, motion.T_reference_camera)
    if contradiction > parameters.max_depth_contradiction:
        contradicted = f"{100 * contradiction:.0f} % of the depth contradicts"
        return f"only {inliers} of {matches} matches agree, and {contradicted}"
    return ""


def doubt_reason(covariance: Array, parameters: SurfParameters) -> str:
    """Why a motion may be grossly wrong; "" if it is not.

    Args:
        covariance: 6x6 of the motion, (translation m, rotation rad).
        parameters: Limits.
    """
    error_m, error_rad = (
        MAX_SIGMAS * float(np.sqrt(np.linalg.eigvalsh(block)[-1]))
        for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    if error_m <= parameters.max_error_m and error_rad <= parameters.max_error_rad:
        return ""
    return (
        f"the matches agree poorly: off by up to {100 * error_m:.0f} cm "
        f"and {np.degrees(error_rad):.1f} degrees"
    )
