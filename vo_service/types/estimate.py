"""The result of every odometry: a pose and its covariance, or why there is none."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array


def _empty_pixels() -> NDArray[np.float32]:
    return np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class TrackingDebug:
    """What a viewer can draw of one estimate. Pixels are (u, v) in the color image.

    Attributes:
        keypoints_px: (N, 2) features of this frame.
        matches_px: (M, 2) matched features of this frame.
        reference_matches_px: (M, 2) the same features in the frame it was matched with: the last
            good one, or an older one after a loss of tracking.
        inlier: (M,) bool, whether the match agrees with the estimated motion.
    """

    keypoints_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    reference_matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    inlier: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))


@dataclass(frozen=True)
class Estimate:
    """The result of one frame.

    Camera axes are x right, y down, z forward; lengths are in meters. The world has the axes of the
    first camera and its place as origin.

    Attributes:
        ok: Whether the motion could be estimated; otherwise `reason` says why not.
        reason: One short clause. If `ok`, what the estimate had to do without, usually "".
        T_world_camera: 4x4 pose, maps camera coordinates to the world. If not `ok`, the last good
            one.
        T_reference_camera: 4x4 motion since the reference: the latest good frame whose estimate has
            `is_next_reference`.
        covariance: 6x6 of `T_reference_camera`, as a small motion in this camera's axes:
            translation (m), then rotation (rad). Zero for the first frame. After a relocalization
            with an older frame, it covers the motion back to that frame and on to this one.
        features: Number of features.
        matches: Number of matched features.
        inliers: Number of matches that agree with the motion.
        is_reset: Whether the pose is not continuous with the previous one.
        is_next_reference: Whether this frame is the reference of the next motion.
        debug: What a viewer can draw.
    """

    ok: bool
    reason: str
    T_world_camera: Array
    T_reference_camera: Array
    covariance: Array
    features: int = 0
    matches: int = 0
    inliers: int = 0
    is_reset: bool = False
    is_next_reference: bool = True
    debug: TrackingDebug = field(default_factory=TrackingDebug)


class Odometry(Protocol):
    """An estimator of the camera's motion; each method of `METHODS` is one."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose at this frame; frames come in the order of their stamps.

        Never raises for what the camera sees: `Estimate.ok` is then False.
        """
        ...
