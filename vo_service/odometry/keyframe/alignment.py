"""The motion that lays a keyframe on a frame, from coarse to fine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, orthonormal
from vo_service.odometry.keyframe import measure
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.cells import CELLS
from vo_service.odometry.keyframe.descent import FIRST_SWEEPS, descend
from vo_service.odometry.keyframe.images import FINE_LEVELS, Images
from vo_service.odometry.keyframe.movement import ACCELERATION, COLUMNS, at_rest, body_movement
from vo_service.odometry.keyframe.parameters import (
    SPANS_S,
    SPREADS,
    VELOCITY_RANGE,
    VELOCITY_SIGMA,
)
from vo_service.odometry.keyframe.readings import read_points
from vo_service.odometry.keyframe.regions import weigh_regions
from vo_service.odometry.keyframe.system import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
    fit_light,
)

Points = Sequence[Array]

# In this time a hand's turning changes by as much as from one frame to the next.
TREMOR_S, *_ = SPANS_S
# Steps at most, by level.
STEPS = (24, 24, 15, 12)
# A step of so few metres and radians is the last one of its level: of the finest it is well below
# the noise, of the others below what the next finer one mends.
LAST_STEPS = (2e-4, 7e-4, 2e-3, 4e-3)


@dataclass(frozen=True)
class Tie:
    """What is known of the movement before a frame is looked at.

    T_keyframe_last  4x4, camera to keyframe, of the frame before
    rate_hz          1 / the time since that frame; 0 without one
    movement         (9,) expected, of the motion in the keyframe's axes, see `movement`
    information      (9,) how well it is known by the mean velocity since the frame before
    """

    T_keyframe_last: Array
    rate_hz: float
    movement: Array
    information: Array

    def loosened(self) -> "Tie":
        """Where the way since the last frame is not known: a velocity that may have changed."""
        sigma = VELOCITY_RANGE[1] * np.array(VELOCITY_SIGMA)
        return replace(self, rate_hz=0.0, information=known_within(sigma))


# Of a frame laid on itself.
STANDING = Tie(np.eye(4), 0.0, at_rest(), np.full(COLUMNS, 1e6))


def known_within(sigma: Array) -> Array:
    """(9,) information of a movement whose velocity is known to sigma (2,), m/s and rad/s."""
    translation, rotation = sigma**-2.0
    acceleration = rotation * TREMOR_S**2
    return np.repeat([translation, rotation, acceleration], 3)


@dataclass(frozen=True)
class Alignment:
    """Where a keyframe's points came to lie.

    T_camera_keyframe  4x4
    movement           (9,) of the motion in the keyframe's axes, see `movement`
    fit                (4,) gain, offset and the two spreads, see `system`
    counts             (7,) see `measure`, of the finest level
    readings           (N, COLUMNS), see `readings`, of the finest level's points
    weights            (2, CELLS) that the cells had
    """

    T_camera_keyframe: Array
    movement: Array
    fit: Array
    counts: Array
    readings: Array
    weights: Array

    @property
    def camera_movement(self) -> Array:
        """(9,) of the camera in its own axes, see `movement`."""
        return body_movement(self.T_camera_keyframe, self.movement)

    @property
    def camera_velocity(self) -> Array:
        """(6,) twist of the camera in its own axes, m/s and rad/s."""
        return self.camera_movement[:ACCELERATION]

    @property
    def is_still(self) -> NDArray[np.bool_]:
        """(CELLS,) which cells of the image fit as well as most do."""
        still: NDArray[np.bool_] = self.weights.max(axis=0) >= measure.LEAST_WEIGHT
        return still

    @property
    def light(self) -> tuple[float, float]:
        """Gain and offset of the frame's brightness against the keyframe's."""
        return float(self.fit[GAIN]), float(self.fit[OFFSET])

    @property
    def by_brightness(self) -> bool:
        """Whether brightness counted at all."""
        return bool(self.weights[0].any())


def all_alike() -> Array:
    """(2, CELLS): every cell counts, by brightness and by depth."""
    return np.ones((2, CELLS))


def depth_alone() -> Array:
    """(2, CELLS): brightness does not count."""
    weights = np.ones((2, CELLS))
    weights[0] = 0.0
    return weights


def start_fit(light: tuple[float, float] = (1.0, 0.0)) -> Array:
    """A fit to begin with."""
    fit = np.empty(4)
    fit[GAIN], fit[OFFSET] = light
    fit[SIGMA_BRIGHTNESS], fit[SIGMA_DEPTH] = SPREADS
    return fit


def align(
    points: Points,
    images: Images,
    starts: Sequence[Array],
    tie: Tie,
    light: tuple[float, float],
    weights: Array,
) -> Alignment:
    """Lay a keyframe's points, an array for each level, on a frame.

    starts    4x4 motions T_camera_keyframe; it begins at the one that fits best
    light     gain and offset of the frame before
    weights   (2, CELLS) of brightness and of depth, by the cell of the image
    """
    # A camera that comes back may have images of another size.
    coarsest = min(len(images.grey), len(points)) - 1
    fit = start_fit(light)
    costs = [_cost(points, images, T, tie.movement, fit, coarsest) for T in starts]
    T, movement = starts[int(np.argmin(costs))], tie.movement
    # Coarse levels have too few points to tell regions by: those of the start are taken there.
    at_start = _regions(points, images, T, movement, fit.copy(), weights)
    for level in range(coarsest, -1, -1):
        T, movement = descend(
            points[level],
            images.grey[level],
            images.intrinsics[level + 1],
            images.inverse_depth,
            images.intrinsics[0],
            images.shutter.readout_s,
            images.shutter.skew_s,
            images.falloff,
            T,
            movement,
            tie.T_keyframe_last,
            tie.rate_hz,
            tie.information,
            weights if level < FINE_LEVELS else at_start,
            fit,
            STEPS[level],
            LAST_STEPS[level],
        )
    T = orthonormal(T)
    readings = look_at(points, images, T, movement, 0)
    by_region = weigh_regions(points[0], readings, fit, weights)
    counts = measure.count(points[0], readings, fit, by_region)
    return Alignment(T, movement, fit, counts, readings, by_region)


def _regions(
    points: Points, images: Images, T: Array, movement: Array, fit: Array, weights: Array
) -> Array:
    """(2, CELLS) weights by how regions fit where the motion is begun."""
    level = min(FINE_LEVELS, len(images.grey)) - 1
    readings = look_at(points, images, T, movement, level)
    for _ in range(FIRST_SWEEPS):
        fit_light(points[level], readings, weights, fit)
    return weigh_regions(points[level], readings, fit, weights)


def look_at(points: Points, images: Images, T: Array, movement: Array, level: int) -> Array:
    """(N, COLUMNS) readings of a level's points at a motion that is given."""
    readings = np.empty((len(points[level]), reading_columns.COLUMNS))
    read_points(
        points[level],
        T,
        body_movement(T, movement),
        images.grey[level],
        images.intrinsics[level + 1],
        images.inverse_depth,
        images.intrinsics[0],
        images.shutter.readout_s,
        images.shutter.skew_s,
        images.falloff,
        readings,
    )
    return readings


def _cost(
    points: Points, images: Images, T: Array, movement: Array, fit: Array, level: int
) -> float:
    """Mean robust cost of all points; those out of view cost as much as the worst."""
    readings = look_at(points, images, T, movement, level)
    counts = measure.count(points[level], readings, fit, all_alike())
    missing = len(points[level]) - counts[measure.IN_IMAGE]
    return float(counts[measure.COST] + measure.MOST_COST * missing) / max(len(points[level]), 1)
