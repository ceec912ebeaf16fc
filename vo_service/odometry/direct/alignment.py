"""The motion that lays a keyframe on a frame, from coarse to fine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, orthonormalize
from vo_service.odometry.direct import residual_stats
from vo_service.odometry.direct import warping as reading_columns
from vo_service.odometry.direct.gauss_newton import INITIAL_SWEEPS, solve_level
from vo_service.odometry.direct.grid import NUM_CELLS
from vo_service.odometry.direct.image_pyramid import NUM_FINE_LEVELS, ImagePyramid
from vo_service.odometry.direct.normal_equations import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
    fit_affine_brightness,
)
from vo_service.odometry.direct.parameters import (
    INITIAL_SIGMAS,
    TIME_SPANS_S,
    VELOCITY_SIGMA,
    VELOCITY_SIGMA_RANGE,
)
from vo_service.odometry.direct.region_weights import weigh_regions
from vo_service.odometry.direct.rolling_shutter import (
    ACCELERATION_START,
    MOTION_SIZE,
    body_motion,
    zero_motion,
)
from vo_service.odometry.direct.warping import warp_and_sample

PointPyramid = Sequence[Array]

# In this time a hand's turning changes by as much as from one frame to the next.
TREMOR_SPAN_S, *_ = TIME_SPANS_S
# Steps at most, by level.
MAX_STEPS = (24, 24, 15, 12)
# A step of so few metres and radians is the last one of its level: of the finest it is well below
# the noise, of the others below what the next finer one mends.
MIN_STEP_SIZES = (2e-4, 7e-4, 2e-3, 4e-3)


@dataclass(frozen=True)
class MotionPrior:
    """What is known of the movement before a frame is looked at.

    T_keyframe_last  4x4, camera to keyframe, of the frame before
    rate_hz          1 / the time since that frame; 0 without one
    movement         (9,) expected, of the motion in the keyframe's axes, see `movement`
    information      (9,) how well it is known by the mean velocity since the frame before
    """

    T_keyframe_last: Array
    rate_hz: float
    motion: Array
    information: Array

    def relaxed(self) -> "MotionPrior":
        """Where the way since the last frame is not known: a velocity that may have changed."""
        sigma = VELOCITY_SIGMA_RANGE[1] * np.array(VELOCITY_SIGMA)
        return replace(self, rate_hz=0.0, information=velocity_information(sigma))


# Of a frame laid on itself.
STATIC_PRIOR = MotionPrior(np.eye(4), 0.0, zero_motion(), np.full(MOTION_SIZE, 1e6))


def velocity_information(sigma: Array) -> Array:
    """(9,) information of a movement whose velocity is known to sigma (2,), m/s and rad/s."""
    translation, rotation = sigma**-2.0
    acceleration = rotation * TREMOR_SPAN_S**2
    return np.repeat([translation, rotation, acceleration], 3)


@dataclass(frozen=True)
class DirectAlignment:
    """Where a keyframe's points came to lie.

    T_camera_keyframe  4x4
    movement           (9,) of the motion in the keyframe's axes, see `movement`
    fit                (4,) gain, offset and the two spreads, see `system`
    counts             (7,) see `measure`, of the finest level
    readings           (N, COLUMNS), see `readings`, of the finest level's points
    weights            (2, CELLS) that the cells had
    """

    T_camera_keyframe: Array
    motion: Array
    residual_model: Array
    counts: Array
    samples: Array
    cell_weights: Array

    @property
    def camera_motion(self) -> Array:
        """(9,) of the camera in its own axes, see `movement`."""
        return body_motion(self.T_camera_keyframe, self.motion)

    @property
    def camera_velocity(self) -> Array:
        """(6,) twist of the camera in its own axes, m/s and rad/s."""
        return self.camera_motion[:ACCELERATION_START]

    @property
    def is_static(self) -> NDArray[np.bool_]:
        """(CELLS,) which cells of the image fit as well as most do."""
        still: NDArray[np.bool_] = self.cell_weights.max(axis=0) >= residual_stats.MIN_STATIC_WEIGHT
        return still

    @property
    def affine_brightness(self) -> tuple[float, float]:
        """Gain and offset of the frame's brightness against the keyframe's."""
        return float(self.residual_model[GAIN]), float(self.residual_model[OFFSET])

    @property
    def uses_brightness(self) -> bool:
        """Whether brightness counted at all."""
        return bool(self.cell_weights[0].any())


def uniform_weights() -> Array:
    """(2, CELLS): every cell counts, by brightness and by depth."""
    return np.ones((2, NUM_CELLS))


def depth_only_weights() -> Array:
    """(2, CELLS): brightness does not count."""
    weights = np.ones((2, NUM_CELLS))
    weights[0] = 0.0
    return weights


def initial_residual_model(affine_brightness: tuple[float, float] = (1.0, 0.0)) -> Array:
    """A fit to begin with."""
    fit = np.empty(4)
    fit[GAIN], fit[OFFSET] = affine_brightness
    fit[SIGMA_BRIGHTNESS], fit[SIGMA_DEPTH] = INITIAL_SIGMAS
    return fit


def align(
    points: PointPyramid,
    images: ImagePyramid,
    initial_guesses: Sequence[Array],
    prior: MotionPrior,
    affine_brightness: tuple[float, float],
    cell_weights: Array,
) -> DirectAlignment:
    """Lay a keyframe's points, an array for each level, on a frame.

    starts    4x4 motions T_camera_keyframe; it begins at the one that fits best
    light     gain and offset of the frame before
    weights   (2, CELLS) of brightness and of depth, by the cell of the image
    """
    # A camera that comes back may have images of another size.
    coarsest = min(len(images.gray), len(points)) - 1
    fit = initial_residual_model(affine_brightness)
    costs = [_mean_cost(points, images, T, prior.motion, fit, coarsest) for T in initial_guesses]
    T, movement = initial_guesses[int(np.argmin(costs))], prior.motion
    # Coarse levels have too few points to tell regions by: those of the start are taken there.
    at_start = _initial_region_weights(points, images, T, movement, fit.copy(), cell_weights)
    for level in range(coarsest, -1, -1):
        T, movement = solve_level(
            points[level],
            images.gray[level],
            images.intrinsics[level + 1],
            images.inverse_depth,
            images.intrinsics[0],
            images.shutter.readout_s,
            images.shutter.skew_s,
            images.vignetting,
            T,
            movement,
            prior.T_keyframe_last,
            prior.rate_hz,
            prior.information,
            cell_weights if level < NUM_FINE_LEVELS else at_start,
            fit,
            MAX_STEPS[level],
            MIN_STEP_SIZES[level],
        )
    T = orthonormalize(T)
    readings = sample_points(points, images, T, movement, 0)
    by_region = weigh_regions(points[0], readings, fit, cell_weights)
    counts = residual_stats.count_residuals(points[0], readings, fit, by_region)
    return DirectAlignment(T, movement, fit, counts, readings, by_region)


def _initial_region_weights(
    points: PointPyramid,
    images: ImagePyramid,
    T: Array,
    motion: Array,
    residual_model: Array,
    cell_weights: Array,
) -> Array:
    """(2, CELLS) weights by how regions fit where the motion is begun."""
    level = min(NUM_FINE_LEVELS, len(images.gray)) - 1
    readings = sample_points(points, images, T, motion, level)
    for _ in range(INITIAL_SWEEPS):
        fit_affine_brightness(points[level], readings, cell_weights, residual_model)
    return weigh_regions(points[level], readings, residual_model, cell_weights)


def sample_points(
    points: PointPyramid, images: ImagePyramid, T: Array, motion: Array, level: int
) -> Array:
    """(N, COLUMNS) readings of a level's points at a motion that is given."""
    readings = np.empty((len(points[level]), reading_columns.NUM_SAMPLE_COLUMNS))
    warp_and_sample(
        points[level],
        T,
        body_motion(T, motion),
        images.gray[level],
        images.intrinsics[level + 1],
        images.inverse_depth,
        images.intrinsics[0],
        images.shutter.readout_s,
        images.shutter.skew_s,
        images.vignetting,
        readings,
    )
    return readings


def _mean_cost(
    points: PointPyramid,
    images: ImagePyramid,
    T: Array,
    motion: Array,
    residual_model: Array,
    level: int,
) -> float:
    """Mean robust cost of all points; those out of view cost as much as the worst."""
    readings = sample_points(points, images, T, motion, level)
    counts = residual_stats.count_residuals(
        points[level], readings, residual_model, uniform_weights()
    )
    missing = len(points[level]) - counts[residual_stats.IN_IMAGE]
    return float(counts[residual_stats.COST] + residual_stats.MAX_POINT_COST * missing) / max(
        len(points[level]), 1
    )
