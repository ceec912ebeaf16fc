"""One frame laid on several keyframes at once: done before it becomes a keyframe itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, adjoint, inverse, orthonormal
from vo_service.odometry.keyframe.alignment import (
    Alignment,
    all_alike,
    look_at,
    start_fit,
)
from vo_service.odometry.keyframe.confidence import agrees
from vo_service.odometry.keyframe.descent import solve
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.measure import count
from vo_service.odometry.keyframe.movement import in_axes
from vo_service.odometry.keyframe.regions import weigh_regions
from vo_service.odometry.keyframe.system import UPPER, fit_light, sum_bands
from vo_service.odometry.keyframe.twists import exponential, product

STEPS = 2
LAST_STEP = 1e-5


@dataclass(eq=False)
class _Pair:
    """A keyframe beside the active one, and its own fit."""

    keyframe: Keyframe
    T_keyframe_active: Array
    fit: Array


def align_jointly(
    active: Keyframe, others: Sequence[Keyframe], images: Images, found: Alignment
) -> Array:
    """4x4 T_camera_active that fits the active keyframe and the others best.

    The keyframes stay where they are, and so does the movement. One that does not agree with the
    frame is left out.
    """
    T = found.T_camera_keyframe
    pairs = [_Pair(active, np.eye(4), found.fit.copy())]
    for other in others:
        T_other_active = inverse(other.T_world_keyframe) @ active.T_world_keyframe
        pairs.append(_Pair(other, T_other_active, start_fit()))
    for step in range(STEPS):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for pair in list(pairs):
            Ad = adjoint(pair.T_keyframe_active)
            T_camera_keyframe = T @ inverse(pair.T_keyframe_active)
            points = pair.keyframe.points[0]
            movement = in_axes(found.movement, pair.T_keyframe_active)
            readings = look_at(pair.keyframe.points, images, T_camera_keyframe, movement, 0)
            cells = weigh_regions(points, readings, pair.fit, all_alike())
            for _ in range(3 if step == 0 else 1):
                fit_light(points, readings, cells, pair.fit)
            if (
                step == 1
                and pair.keyframe is not active
                and not agrees(count(points, readings, pair.fit, cells))
            ):
                pairs.remove(pair)
                continue
            sums = sum_bands(points, readings, cells, pair.fit).sum(axis=0)
            H += Ad.T @ sums[UPPER] @ Ad
            g += Ad.T @ sums[21:]
        x = solve(H + 1e-6 * np.trace(H) * np.eye(6), g)
        T = product(T, exponential(-x))
        if np.max(np.abs(x)) < LAST_STEP:
            break
    return orthonormal(T)
