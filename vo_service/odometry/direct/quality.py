"""Quality of an alignment: reasons to reject it, and what it lacks.

Also the result of the tracking, with its debug data for a viewer.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.gauss_newton import MotionPrior
from vo_service.odometry.direct.image_pyramid import GAIN_RANGE
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import (
    ACCELERATION_START,
    body_motion,
    compose,
    constant_velocity_motion,
    invert,
    project,
)
from vo_service.odometry.direct.parameters import (
    INITIAL_SIGMAS,
    MAX_MOVING_OR_OCCLUDED_SHARE,
    MAX_OCCLUDED_SHARE,
    MAX_VALID_CONTRAST_SHARE,
    MAX_VALID_RATIOS,
    MIN_CONSISTENT_SHARE,
    MIN_IN_VIEW_SHARE,
    MIN_MODALITY_SHARE,
    MIN_SAMPLES,
    SUSPECT_SIGMA_SHARE,
)
from vo_service.odometry.direct.points import Points
from vo_service.odometry.direct.residuals import (
    ResidualCounts,
    ResidualModel,
    find_inliers,
    negative_log_likelihood,
)
from vo_service.odometry.direct.samples import Samples
from vo_service.types.estimate import TrackingDebug

# Every 4th point is enough to see.
POINT_STRIDE = 4
NO_DEPTH = "brightness only: no depth in view"


def is_consistent(counts: ResidualCounts) -> bool:
    """Whether most depth and brightness samples agree with the keyframe."""
    return not _inconsistency_reason(counts)


def _inconsistency_reason(counts: ResidualCounts) -> str:
    """Which kind of samples does not agree with the keyframe; "" if both do."""
    for what, agreeing, total in (
        ("depth samples", counts.depth_agrees, counts.with_depth),
        ("brightness samples", counts.brightness_agrees, counts.with_brightness),
    ):
        if agreeing < MIN_CONSISTENT_SHARE * total:
            return f"only {agreeing:.0f} of {total:.0f} {what} agree with the keyframe"
    return ""


def rejection_reason(alignment: DirectAlignment) -> str:
    """Why an alignment is rejected; "" if it is valid."""
    counts = alignment.counts
    points = len(alignment.samples.cell)
    in_view = int(counts.in_image)
    if in_view < max(MIN_IN_VIEW_SHARE * points, MIN_SAMPLES):
        return f"only {in_view} of {points} points of the keyframe are in view"
    if counts.disregarded > MAX_MOVING_OR_OCCLUDED_SHARE * in_view:
        return f"{100 * counts.disregarded / in_view:.0f} % of the view does not fit"
    sampled = int(counts.with_depth + counts.with_brightness)
    if sampled < MIN_SAMPLES:
        return f"only {sampled} samples in view"
    if alignment.uses_brightness and not GAIN_RANGE[0] < alignment.gain < GAIN_RANGE[1]:
        return "the brightness changed too much against the keyframe"
    if reason := _inconsistency_reason(counts):
        return reason
    brightness, depth = relative_sigmas(alignment)
    if depth > 1.0:
        return "the depth does not fit the keyframe"
    if alignment.uses_brightness and brightness > 1.0:
        return "the brightness does not fit the keyframe"
    return ""


def relative_sigmas(alignment: DirectAlignment) -> tuple[float, float]:
    """Sigmas of brightness and of depth, relative to the largest valid ones."""
    model = alignment.residual_model
    max_brightness = max(
        MAX_VALID_RATIOS[0] * INITIAL_SIGMAS[0], MAX_VALID_CONTRAST_SHARE * model.contrast
    )
    max_depth = MAX_VALID_RATIOS[1] * INITIAL_SIGMAS[1] * model.depth_noise
    return model.sigma_brightness / max_brightness, model.sigma_depth / max_depth


def is_suspect(alignment: DirectAlignment) -> bool:
    """Whether a valid fit is so bad that it may be that of another place."""
    brightness, depth = relative_sigmas(alignment)
    return max(depth, brightness if alignment.uses_brightness else 0.0) > SUSPECT_SIGMA_SHARE


def occluded_fraction(alignment: DirectAlignment) -> float:
    """Share of the view in which something occludes the keyframe's points."""
    count = alignment.counts.occluded
    return count / max(count + alignment.counts.in_image, 1.0)


def occlusion_reason(alignment: DirectAlignment) -> str:
    """Why a good fit may be that of an object in front of the room; "" if it is not."""
    moving = alignment.counts.disregarded / max(alignment.counts.in_image, 1.0)
    share = 1.0 - (1.0 - occluded_fraction(alignment)) * (1.0 - moving)
    return _occlusion_message(share) if share > MAX_MOVING_OR_OCCLUDED_SHARE else ""


def degradation_reason(alignment: DirectAlignment) -> str:
    """What an alignment lacks; "" if depth and brightness constrain nearly all of the view."""
    counts = alignment.counts
    enough = MIN_MODALITY_SHARE * counts.in_image
    if counts.with_brightness < enough:
        return "depth only: no texture in view"
    if counts.with_depth < enough:
        return NO_DEPTH
    return (
        _occlusion_message(occluded_fraction(alignment))
        if occluded_fraction(alignment) > MAX_OCCLUDED_SHARE
        else ""
    )


def _occlusion_message(share: float) -> str:
    return f"{100 * share:.0f} % of the view is occluded"


def make_tracking_debug(keyframe: DirectKeyframe, alignment: DirectAlignment) -> TrackingDebug:
    """Make the debug data of every 4th point; matches are points with a brightness sample."""
    return TrackingDebug(
        *_select_drawn_points(
            keyframe.points[0],
            alignment.samples,
            alignment.residual_model,
            keyframe.images.intrinsics[0],
        )
    )


@kernel
def _select_drawn_points(
    points: Points, samples: Samples, residual_model: ResidualModel, intrinsics: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Fields of `TrackingDebug`, of every 4th of points and of their samples."""
    in_keyframe = _project_points(points.position_m, intrinsics)
    is_inlier = find_inliers(points, samples, residual_model)
    keypoints, matches = np.empty_like(in_keyframe), np.empty_like(in_keyframe)
    in_image = sampled = 0
    for drawn in range(len(in_keyframe)):
        n = drawn * POINT_STRIDE
        keypoints[in_image, 0] = matches[sampled, 0] = samples.u[n]
        keypoints[in_image, 1] = matches[sampled, 1] = samples.v[n]
        for k in range(2):
            in_keyframe[sampled, k] = in_keyframe[drawn, k]
        is_inlier[sampled] = is_inlier[n]
        in_image += samples.cell[n] >= 0
        sampled += not np.isnan(samples.brightness[n])
    return keypoints[:in_image], matches[:sampled], in_keyframe[:sampled], is_inlier[:sampled]


def project_keyframe_points(keyframe: DirectKeyframe) -> NDArray[np.float32]:
    """(N, 2) pixels of every 4th keyframe point in the keyframe's image."""
    return _project_points(keyframe.points[0].position_m, keyframe.images.intrinsics[0])


@kernel
def _project_points(position_m: Array, intrinsics: Array) -> NDArray[np.float32]:
    """(M, 2) pixels of every 4th of points (3, N) in a keyframe's axes."""
    drawn = position_m[:, ::POINT_STRIDE]
    pixels = np.empty((drawn.shape[1], 2), np.float32)
    for n in range(len(pixels)):
        u, v = project(drawn[0, n], drawn[1, n], drawn[2, n], intrinsics)
        pixels[n, 0], pixels[n, 1] = u, v
    return pixels


@dataclass(frozen=True)
class TrackingResult:
    """Alignment of a frame with a keyframe.

    Attributes:
        keyframe: The keyframe that the frame is aligned with.
        alignment: The motion and its residuals.
        prior: What was known of the motion.
        degradation: What the alignment lacks; "" for nothing.
    """

    keyframe: DirectKeyframe
    alignment: DirectAlignment
    prior: MotionPrior
    degradation: str = ""

    @cached_property
    def T_world_camera(self) -> Array:
        """4x4 pose of the camera."""
        return self.keyframe.T_world_keyframe @ inverse(self.alignment.T_camera_keyframe)

    @cached_property
    def negative_log_likelihood(self) -> float:
        """Of the whole view, by which two motions are compared; see `residuals`."""
        return negative_log_likelihood(
            self.keyframe.points[0], self.alignment.samples, self.alignment.residual_model
        )

    def with_pose(self, T_world_camera: Array, velocity: Array) -> "TrackingResult":
        """Return a copy with another pose (4x4) and velocity (6,), in the camera's own axes."""
        T_camera_keyframe = compose(invert(T_world_camera), self.keyframe.T_world_keyframe)
        moved = body_motion(invert(T_camera_keyframe), constant_velocity_motion(velocity))
        motion = np.concatenate(
            [moved[:ACCELERATION_START], self.alignment.motion[ACCELERATION_START:]]
        )
        alignment = replace(self.alignment, T_camera_keyframe=T_camera_keyframe, motion=motion)
        return replace(self, alignment=alignment)
