"""Joint alignment of a frame with several keyframes, before it becomes a keyframe itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, adjoint, inverse, orthonormalize
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    initial_residual_model,
    sample_points,
    uniform_weights,
)
from vo_service.odometry.direct.gauss_newton import solve_cholesky
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.normal_equations import (
    UPPER_TRIANGLE,
    accumulate,
    fit_affine_brightness,
)
from vo_service.odometry.direct.parameters import (
    INITIAL_MODEL_UPDATES,
    JOINT_DAMPING_RATIO,
    MAX_JOINT_STEPS,
    MIN_JOINT_STEP_SIZE,
)
from vo_service.odometry.direct.quality import is_consistent
from vo_service.odometry.direct.region_weights import weigh_regions
from vo_service.odometry.direct.residual_stats import count_residuals
from vo_service.odometry.direct.rolling_shutter import change_frame
from vo_service.odometry.direct.se3 import compose, se3_exp


@dataclass(eq=False)
class _KeyframeFit:
    """A keyframe, its pose relative to the active one, and its residual model."""

    keyframe: DirectKeyframe
    T_keyframe_active: Array
    residual_model: Array


def align_jointly(
    active: DirectKeyframe,
    others: Sequence[DirectKeyframe],
    images: ImagePyramid,
    alignment: DirectAlignment,
) -> Array:
    """Estimate T_camera_active (4x4) from the active keyframe and the others.

    The poses of the keyframes and the motion stay fixed. A keyframe that does not agree with the
    frame is left out.
    """
    T = alignment.T_camera_keyframe
    fits = [_KeyframeFit(active, np.eye(4), alignment.residual_model.copy())]
    for other in others:
        T_other_active = inverse(other.T_world_keyframe) @ active.T_world_keyframe
        fits.append(_KeyframeFit(other, T_other_active, initial_residual_model()))
    for step in range(MAX_JOINT_STEPS):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for fit in list(fits):
            Ad = adjoint(fit.T_keyframe_active)
            T_camera_keyframe = T @ inverse(fit.T_keyframe_active)
            points = fit.keyframe.points[0]
            motion = change_frame(alignment.motion, fit.T_keyframe_active)
            samples = sample_points(fit.keyframe.points, images, T_camera_keyframe, motion, 0)
            cell_weights = weigh_regions(points, samples, fit.residual_model, uniform_weights())
            for _ in range(INITIAL_MODEL_UPDATES if step == 0 else 1):
                fit_affine_brightness(points, samples, cell_weights, fit.residual_model)
            if (
                step == 1
                and fit.keyframe is not active
                and not is_consistent(
                    count_residuals(points, samples, fit.residual_model, cell_weights)
                )
            ):
                fits.remove(fit)
                continue
            sums = accumulate(points, samples, cell_weights, fit.residual_model).sum(axis=0)
            H += Ad.T @ sums[UPPER_TRIANGLE] @ Ad
            g += Ad.T @ sums[21:]
        x = solve_cholesky(H + JOINT_DAMPING_RATIO * np.trace(H) * np.eye(6), g)
        T = compose(T, se3_exp(-x))
        if np.max(np.abs(x)) < MIN_JOINT_STEP_SIZE:
            break
    return orthonormalize(T)
