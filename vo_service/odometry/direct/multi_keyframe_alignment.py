"""One frame laid on several keyframes at once: done before it becomes a keyframe itself."""

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
from vo_service.odometry.direct.quality import is_consistent
from vo_service.odometry.direct.region_weights import weigh_regions
from vo_service.odometry.direct.residual_stats import count_residuals
from vo_service.odometry.direct.rolling_shutter import change_frame
from vo_service.odometry.direct.se3 import compose, se3_exp

MAX_STEPS = 2
MIN_STEP_SIZE = 1e-5


@dataclass(eq=False)
class _KeyframeFit:
    """A keyframe beside the active one, and its own fit."""

    keyframe: DirectKeyframe
    T_keyframe_active: Array
    residual_model: Array


def align_jointly(
    active: DirectKeyframe,
    others: Sequence[DirectKeyframe],
    images: ImagePyramid,
    alignment: DirectAlignment,
) -> Array:
    """4x4 T_camera_active that fits the active keyframe and the others best.

    The keyframes stay where they are, and so does the movement. One that does not agree with the
    frame is left out.
    """
    T = alignment.T_camera_keyframe
    pairs = [_KeyframeFit(active, np.eye(4), alignment.residual_model.copy())]
    for other in others:
        T_other_active = inverse(other.T_world_keyframe) @ active.T_world_keyframe
        pairs.append(_KeyframeFit(other, T_other_active, initial_residual_model()))
    for step in range(MAX_STEPS):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for pair in list(pairs):
            Ad = adjoint(pair.T_keyframe_active)
            T_camera_keyframe = T @ inverse(pair.T_keyframe_active)
            points = pair.keyframe.points[0]
            movement = change_frame(alignment.motion, pair.T_keyframe_active)
            readings = sample_points(pair.keyframe.points, images, T_camera_keyframe, movement, 0)
            cells = weigh_regions(points, readings, pair.residual_model, uniform_weights())
            for _ in range(3 if step == 0 else 1):
                fit_affine_brightness(points, readings, cells, pair.residual_model)
            if (
                step == 1
                and pair.keyframe is not active
                and not is_consistent(count_residuals(points, readings, pair.residual_model, cells))
            ):
                pairs.remove(pair)
                continue
            sums = accumulate(points, readings, cells, pair.residual_model).sum(axis=0)
            H += Ad.T @ sums[UPPER_TRIANGLE] @ Ad
            g += Ad.T @ sums[21:]
        x = solve_cholesky(H + 1e-6 * np.trace(H) * np.eye(6), g)
        T = compose(T, se3_exp(-x))
        if np.max(np.abs(x)) < MIN_STEP_SIZE:
            break
    return orthonormalize(T)
