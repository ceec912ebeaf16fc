"""Alignment of a keyframe's points with a frame, from coarse to fine."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.gauss_newton import MotionPrior, StepLimits, solve_level
from vo_service.odometry.direct.image_pyramid import (
    NUM_CELLS,
    NUM_LEVELS,
    ImagePyramid,
    LevelImages,
)
from vo_service.odometry.direct.motion import (
    ACCELERATION_START,
    MOTION_SIZE,
    body_motion,
    orthonormalize_rotation,
    zero_motion,
)
from vo_service.odometry.direct.parameters import (
    INITIAL_MODEL_UPDATES,
    INITIAL_SIGMAS,
    MAX_STEPS,
    MIN_STATIC_WEIGHT,
    MIN_STEP_SIZES,
    NUM_FINE_LEVELS,
)
from vo_service.odometry.direct.points import Points
from vo_service.odometry.direct.residuals import (
    ResidualCounts,
    ResidualModel,
    count_residuals,
    fit_residual_model,
    weigh_regions,
    weigh_samples,
)
from vo_service.odometry.direct.samples import Samples, empty_samples, warp_and_sample

PointPyramid = Sequence[Points]
Level = TypeVar("Level", Points, LevelImages)

STEP_LIMITS = tuple(StepLimits(*limits) for limits in zip(MAX_STEPS, MIN_STEP_SIZES, strict=True))
# Information of a motion that is known, so that the images hardly change it.
STATIC_INFORMATION = np.full(MOTION_SIZE, 1e6)
# For a frame that is aligned with itself.
STATIC_PRIOR = MotionPrior(np.eye(4), 0.0, zero_motion(), STATIC_INFORMATION)


@dataclass(frozen=True)
class DirectAlignment:
    """Alignment of a keyframe's points with a frame.

    Attributes:
        T_camera_keyframe: 4x4.
        motion: (9,) of the keyframe's points in the keyframe's axes, see `motion`.
        residual_model: Of the finest level.
        counts: Of the finest level.
        samples: Of the finest level's points.
        cell_weights: (2, CELLS) of brightness and of depth.
    """

    T_camera_keyframe: Array
    motion: Array
    residual_model: ResidualModel
    counts: ResidualCounts
    samples: Samples
    cell_weights: Array

    @cached_property
    def camera_motion(self) -> Array:
        """(9,) motion of the camera in its own axes, see `motion`."""
        return body_motion(self.T_camera_keyframe, self.motion)

    @property
    def camera_velocity(self) -> Array:
        """(6,) twist of the camera in its own axes, m/s and rad/s."""
        return self.camera_motion[:ACCELERATION_START]

    @property
    def is_static(self) -> NDArray[np.bool_]:
        """(CELLS,) which cells of the image do not move by themselves."""
        is_static: NDArray[np.bool_] = self.cell_weights.max(axis=0) >= MIN_STATIC_WEIGHT
        return is_static

    @property
    def gain(self) -> float:
        """Ratio of the frame's brightness to the keyframe's."""
        return self.residual_model.gain

    @cached_property
    def uses_brightness(self) -> bool:
        """Whether brightness has any weight."""
        return bool(self.cell_weights[0].any())


def uniform_weights() -> Array:
    """(2, CELLS) equal weights of brightness and depth in every cell."""
    return np.ones((2, NUM_CELLS))


def depth_only_weights() -> Array:
    """(2, CELLS) weights without brightness."""
    weights = np.ones((2, NUM_CELLS))
    weights[0] = 0.0
    return weights


def initial_residual_model(
    images: ImagePyramid, points: Points, gain: float = 1.0
) -> ResidualModel:
    """Return the residual model of a frame before the first step.

    Args:
        images: The frame.
        points: Of the keyframe's finest level.
        gain: Initial ratio of the frame's brightness to the keyframe's.
    """
    sigma_brightness, sigma_depth = INITIAL_SIGMAS
    return ResidualModel(
        gain,
        sigma_brightness,
        sigma_depth * images.depth_noise,
        images.brightness_weight,
        images.depth_noise,
        _contrast(points),
    )


@kernel
def _contrast(points: Points) -> float:
    """Standard deviation of the brightness of points, gray levels."""
    mean, squared, count = 0.0, 0.0, len(points.brightness)
    for brightness in points.brightness:
        mean += brightness / count
    for brightness in points.brightness:
        squared += (brightness - mean) ** 2 / count
    return float(np.sqrt(squared))


def align(
    points: PointPyramid,
    images: ImagePyramid,
    T_camera_keyframe: Array,
    prior: MotionPrior,
    gain: float,
    cell_weights: Array,
) -> DirectAlignment:
    """Align a keyframe's points with a frame.

    Args:
        points: Of each level, finest first.
        images: The frame.
        T_camera_keyframe: 4x4 initial guess.
        prior: What is known of the motion.
        gain: Initial ratio of the frame's brightness to the keyframe's.
        cell_weights: (2, CELLS) of brightness and of depth, by the cell of the image.
    """
    levels, initial_model = images.levels, initial_residual_model(images, points[0], gain)
    if not len(points[0].brightness):
        nothing, samples = ResidualCounts(), empty_samples(0)
        return DirectAlignment(
            T_camera_keyframe, prior.motion, initial_model, nothing, samples, cell_weights
        )
    # After a reconnection the camera may have images of another size.
    count = min(len(levels), len(points))
    T, motion, residual_model, counts, samples, region_weights = _align_levels(
        _pad(points[:count]),
        _pad(levels[:count]),
        count,
        T_camera_keyframe,
        prior,
        initial_model,
        cell_weights,
    )
    return DirectAlignment(T, motion, residual_model, counts, samples, region_weights)


def _pad(levels: Sequence[Level]) -> tuple[Level, ...]:
    """Repeat the coarsest level: a kernel is compiled for each length of a tuple."""
    padded = list(levels)
    return tuple(padded + padded[-1:] * (NUM_LEVELS - len(padded)))


@kernel
def _align_levels(
    points: tuple[Points, ...],
    images: tuple[LevelImages, ...],
    count: int,
    T: Array,
    prior: MotionPrior,
    residual_model: ResidualModel,
    cell_weights: Array,
) -> tuple[Array, Array, ResidualModel, ResidualCounts, Samples, Array]:
    """Fields of `DirectAlignment`, see `align`. In one kernel, as each call from Python takes time.

    Args:
        points: Of each level.
        images: The frame at each level.
        count: Number of levels.
        T: 4x4 initial guess of T_camera_keyframe.
        prior: What is known of the motion.
        residual_model: Initial one.
        cell_weights: (2, CELLS).
    """
    motion = prior.motion
    # Coarse levels have too few points for region weights: those of the initial guess are used.
    level = min(count, NUM_FINE_LEVELS) - 1
    initial_weights = _initial_region_weights(
        points[level], images[level], T, motion, residual_model, cell_weights
    )
    for level in range(count - 1, -1, -1):
        T, motion, residual_model = solve_level(
            points[level],
            images[level],
            T,
            motion,
            prior,
            cell_weights if level < NUM_FINE_LEVELS else initial_weights,
            residual_model,
            STEP_LIMITS[level],
        )
    T = orthonormalize_rotation(T)
    samples = _sample_level(points[0], images[0], T, motion)
    region_weights = weigh_regions(points[0], samples, residual_model, cell_weights)
    counts = count_residuals(points[0], samples, residual_model, region_weights)
    return T, motion, residual_model, counts, samples, region_weights


def sample_points(
    points: PointPyramid, images: ImagePyramid, T: Array, motion: Array, level: int
) -> Samples:
    """Sample a level's points at a given motion.

    Args:
        points: Of each level, finest first.
        images: The frame.
        T: 4x4 T_camera_keyframe.
        motion: (9,) of the keyframe's points in the keyframe's axes.
        level: Of the points and the images; 0 is the finest.
    """
    return _sample_level(points[level], images.levels[level], T, motion)


@kernel
def _sample_level(points: Points, images: LevelImages, T: Array, motion: Array) -> Samples:
    samples = empty_samples(len(points.brightness))
    warp_and_sample(points, images, T, body_motion(T, motion), samples)
    return samples


@kernel
def _initial_region_weights(
    points: Points,
    images: LevelImages,
    T: Array,
    motion: Array,
    residual_model: ResidualModel,
    cell_weights: Array,
) -> Array:
    """(2, CELLS) weights of the regions at the initial guess, by a level's points."""
    samples = _sample_level(points, images, T, motion)
    weighted = weigh_samples(points, samples, cell_weights)
    for _ in range(INITIAL_MODEL_UPDATES):
        residual_model = fit_residual_model(points, weighted, residual_model)
    return weigh_regions(points, samples, residual_model, cell_weights)
