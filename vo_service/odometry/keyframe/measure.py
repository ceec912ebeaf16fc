"""What an alignment rests on: how much is seen, how much of that agrees, and how sure it makes."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.parameters import FREEDOM
from vo_service.odometry.keyframe.points import BRIGHTNESS, HAS_SHAPE, HAS_TEXTURE, VARIANCE
from vo_service.odometry.keyframe.readings import read_points
from vo_service.odometry.keyframe.system import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
)

# The counts: points in the image; of those, such with a depth that counts, and such whose depth
# agrees to three sigma; the same of brightness; then the robust cost of all points.
IN_IMAGE, WITH_DEPTH, DEPTH_AGREES, WITH_BRIGHTNESS, BRIGHTNESS_AGREES, COST = range(6)
# As many squared standard deviations as a reading may be off and agree.
AGREEING = 9.0


@kernel
def count(points: Array, readings: Array, fit: Array, counts: Array) -> None:
    """Fill in the counts (6,). What lies on another surface costs the most."""
    counts[:] = 0.0
    variance, variance_depth = fit[SIGMA_BRIGHTNESS] ** 2, fit[SIGMA_DEPTH] ** 2
    worst = np.log(1.0 + AGREEING / FREEDOM)
    for i in range(len(points)):
        if readings[i, reading_columns.CELL] < 0:
            continue
        counts[IN_IMAGE] += 1.0
        brightness, depth = (
            readings[i, reading_columns.BRIGHTNESS],
            readings[i, reading_columns.DEPTH],
        )
        is_other = np.isnan(brightness)
        if points[i, HAS_SHAPE] > 0 and (is_other or not np.isnan(depth)):
            squared = AGREEING if is_other else min(depth * depth / variance_depth, AGREEING)
            counts[WITH_DEPTH] += 1.0
            counts[DEPTH_AGREES] += squared < AGREEING
            counts[COST] += np.log(1.0 + squared / FREEDOM)
        if points[i, HAS_TEXTURE] > 0:
            counts[WITH_BRIGHTNESS] += 1.0
            if is_other:
                counts[COST] += worst
                continue
            residual = brightness - fit[GAIN] * points[i, BRIGHTNESS] - fit[OFFSET]
            squared = min(residual * residual / (variance + points[i, VARIANCE]), AGREEING)
            counts[BRIGHTNESS_AGREES] += squared < AGREEING
            counts[COST] += np.log(1.0 + squared / FREEDOM)


@kernel
def look(
    points: Array,
    grey: NDArray[np.uint8],
    intrinsics: Array,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    T_camera_keyframe: Array,
    camera_velocity: Array,
    fit: Array,
) -> tuple[Array, Array]:
    """Readings (N, COLUMNS) of points, and their counts, at a given motion and with a given fit."""
    readings = np.empty((len(points), reading_columns.COLUMNS))
    counts = np.empty(6)
    read_points(
        points,
        T_camera_keyframe,
        camera_velocity,
        grey,
        intrinsics,
        inverse_depth,
        depth_intrinsics,
        readout_s,
        skew_s,
        readings,
    )
    count(points, readings, fit, counts)
    return readings, counts


@kernel
def is_agreeing(points: Array, readings: Array, fit: Array) -> NDArray[np.bool_]:
    """(N,) whether what is read of a point, of brightness and of depth, agrees with it."""
    agreeing = np.zeros(len(points), np.bool_)
    variance, variance_depth = fit[SIGMA_BRIGHTNESS] ** 2, fit[SIGMA_DEPTH] ** 2
    for i in range(len(points)):
        brightness = readings[i, reading_columns.BRIGHTNESS]
        depth = readings[i, reading_columns.DEPTH]
        if np.isnan(brightness):
            continue
        residual = brightness - fit[GAIN] * points[i, BRIGHTNESS] - fit[OFFSET]
        is_lit = residual * residual < AGREEING * (variance + points[i, VARIANCE])
        is_there = np.isnan(depth) or depth * depth < AGREEING * variance_depth
        agreeing[i] = (is_lit or points[i, HAS_TEXTURE] == 0) and (
            is_there or points[i, HAS_SHAPE] == 0
        )
    return agreeing
