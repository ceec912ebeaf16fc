"""A second look where the camera seems to have been jolted: its motion may follow a thing.

A thing that is near and has much texture can be followed by turning against it: what is far stays
where it was, and nearly all of the view fits. So each half of the view is left out in turn. What is
left then has the say, and the motion that is found is that of the room if the thing is in the other
half.
"""

from dataclasses import replace
from math import log

import numpy as np

from drivers.geometry import Array
from vo_service.odometry.keyframe import measure
from vo_service.odometry.keyframe.alignment import Alignment, align, all_alike
from vo_service.odometry.keyframe.cells import CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.keyframe.confidence import doubt
from vo_service.odometry.keyframe.images import FINE_LEVELS, Images
from vo_service.odometry.keyframe.parameters import FREEDOM, SIGMAS, SLIGHT
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.regions import weigh_regions
from vo_service.odometry.keyframe.system import SIGMA_BRIGHTNESS
from vo_service.odometry.keyframe.way import Way

# Columns of cells that are left out: half of the view, on the left, in the middle, on the right.
HALVES = (slice(0, 4), slice(2, 6), slice(4, 8))


def look_again(found: Found, images: Images, way: Way) -> Found:
    """The same, or the motion without half of the view that fits better and surprises less."""
    if way.surprise(found.alignment.camera_velocity, images.stamp_s) < SIGMAS:
        return found
    others = [_without(half, found, images, way) for half in HALVES]
    motions = [found.alignment, *(other for other in others if not doubt(other))]
    spreads = np.min([motion.fit for motion in motions], axis=0)[SIGMA_BRIGHTNESS:]
    points = found.keyframe.points[0]

    def cost(motion: Alignment) -> float:
        surprise = way.surprise(motion.camera_velocity, images.stamp_s)
        return _misfit(points, motion, spreads) + SLIGHT * log(1 + surprise**2 / FREEDOM)

    return replace(found, alignment=min(motions, key=cost))


def _without(half: slice, found: Found, images: Images, way: Way) -> Alignment:
    """The motion of half of the view, then of all that fits it."""
    points, tie = found.keyframe.points, found.tie
    weights = all_alike()
    weights.reshape(2, CELL_ROWS, CELL_COLUMNS)[:, :, half] = 0.0
    expected = way.starts(found.keyframe.T_world_keyframe, images.stamp_s)[:1]
    part = align(points, images, expected, tie, way.light_at(images), weights)
    by_region = weigh_regions(points[0], part.readings, part.fit, all_alike())
    fitting = (by_region >= measure.LEAST_WEIGHT).astype(np.float64)
    return align(points[:FINE_LEVELS], images, [part.T_camera_keyframe], tie, part.light, fitting)


def _misfit(points: Array, motion: Alignment, spreads: Array) -> float:
    """Mean robust cost of a reading in all of the view, by spreads (2,) that are given."""
    fit = motion.fit.copy()
    fit[SIGMA_BRIGHTNESS:] = spreads
    counts = measure.count(points, motion.readings, fit, all_alike())
    read = counts[measure.WITH_DEPTH] + counts[measure.WITH_BRIGHTNESS]
    return float(counts[measure.COST] / max(read, 1.0))
