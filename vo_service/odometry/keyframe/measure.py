"""What an alignment rests on: how much is seen, how much of that agrees, and how sure it makes."""

from math import log

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.parameters import FREEDOM, HALF, SIGMAS
from vo_service.odometry.keyframe.points import BRIGHTNESS, HAS_SHAPE, HAS_TEXTURE, VARIANCE
from vo_service.odometry.keyframe.readings import HIDDEN
from vo_service.odometry.keyframe.system import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
)

# The counts: points in the image; of these, such in regions that hardly count; then by weight, such
# with a depth that counts, and such whose depth agrees to three sigma; the same of brightness; and
# the robust cost of all.
IN_IMAGE, DISREGARDED, WITH_DEPTH, DEPTH_AGREES, WITH_BRIGHTNESS, BRIGHTNESS_AGREES, COST = range(7)
# As many squared standard deviations as a reading may be off and agree. What is off by more
# counts as if by so many.
AGREEING = SIGMAS**2
# What a point costs at most, whose brightness and depth are both wrong.
MOST_COST = 2.0 * log(1.0 + AGREEING / FREEDOM)
# A region of less weight hardly counts.
LEAST_WEIGHT = HALF


@kernel
def count(points: Array, readings: Array, fit: Array, weights: Array) -> Array:
    """Counts (7,). What another surface is seen through costs the most; what one hides, nothing."""
    counts = np.zeros(7)
    variance, variance_depth = fit[SIGMA_BRIGHTNESS] ** 2, fit[SIGMA_DEPTH] ** 2
    for i in range(len(points)):
        cell = int(readings[i, reading_columns.CELL])
        if cell < 0 or readings[i, reading_columns.OTHER] == HIDDEN:
            continue
        by_brightness, by_depth = weights[0, cell], weights[1, cell]
        counts[IN_IMAGE] += 1.0
        counts[DISREGARDED] += max(by_brightness, by_depth) < LEAST_WEIGHT
        brightness = readings[i, reading_columns.BRIGHTNESS]
        depth = readings[i, reading_columns.DEPTH]
        is_other = np.isnan(brightness)
        if points[i, HAS_SHAPE] > 0 and (is_other or not np.isnan(depth)):
            squared = AGREEING if is_other else min(depth * depth / variance_depth, AGREEING)
            counts[WITH_DEPTH] += by_depth
            counts[DEPTH_AGREES] += by_depth * (squared < AGREEING)
            counts[COST] += by_depth * np.log(1.0 + squared / FREEDOM)
        if points[i, HAS_TEXTURE] > 0:
            squared = AGREEING
            if not is_other:
                residual = brightness - fit[GAIN] * points[i, BRIGHTNESS] - fit[OFFSET]
                squared = min(residual * residual / (variance + points[i, VARIANCE]), AGREEING)
            counts[WITH_BRIGHTNESS] += by_brightness
            counts[BRIGHTNESS_AGREES] += by_brightness * (squared < AGREEING)
            counts[COST] += by_brightness * np.log(1.0 + squared / FREEDOM)
    return counts


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
