"""The odometry's estimate of a frame."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse


def _empty_pixels() -> NDArray[np.float32]:
    return np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class TrackingDebug:
    """Data of one estimate for a viewer. Pixels are (u, v) in the color image.

    Attributes:
        keypoints_px: (N, 2) features of this frame.
        matches_px: (M, 2) matched features of this frame.
        reference_matches_px: (M, 2) the same features in the reference frame: the last good frame,
            or an older one after a loss of tracking.
        inlier: (M,) bool, whether the match agrees with the estimated motion.
    """

    keypoints_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    reference_matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    inlier: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))

    def scaled(self, scale: int) -> "TrackingDebug":
        """Return a copy for an image that is larger by this factor."""
        factor = np.float32(scale)
        return TrackingDebug(
            factor * self.keypoints_px,
            factor * self.matches_px,
            factor * self.reference_matches_px,
            self.inlier,
        )


# Source of a timing that the odometry has learned.
LEARNED_TIMING = "learned"


@dataclass(frozen=True)
class OnlineTiming:
    """The sensor's timing that an odometry uses.

    Attributes:
        readout_s: Rolling shutter: from the first row to the last.
        depth_offset_s: Capture time of a depth image minus its stamp, relative to color.
        readout_sigma_s: Standard deviation of `readout_s`.
        depth_offset_sigma_s: Standard deviation of `depth_offset_s`.
        source: Where the values come from: `LEARNED_TIMING`, or see `TimingSource`.
        contradiction: Readout and depth offset by the frames alone, s, if they contradict what the
            camera file or the usual values say; None otherwise.
        is_refused: Whether a learned timing is not used, as frames fit no better with it.
    """

    readout_s: float
    depth_offset_s: float
    readout_sigma_s: float
    depth_offset_sigma_s: float
    source: str
    contradiction: tuple[float, float] | None = None
    is_refused: bool = False

    @property
    def warning(self) -> str:
        """What to do if the frames contradict what they tell; "" if they do not."""
        if self.contradiction is None:
            return ""
        readout_ms, offset_ms = (1e3 * value_s for value_s in self.contradiction)
        return (
            f"the frames contradict the told timing: they show a readout of {readout_ms:.0f} ms "
            f"and a depth offset of {offset_ms:.0f} ms; run kinect-vo calibrate --timing"
        )


@dataclass(frozen=True)
class OnlineFocalLength:
    """The color camera's focal length that an odometry uses.

    Attributes:
        scale: Ratio to that of the frames; exactly 1 while it is not corrected.
        sigma: Standard deviation of `scale`.
        disagreement: Difference of the scale by depth from that by brightness, about zero for a
            calibrated camera; None while unsure.
        source: "intrinsics", "memory" (learned at an earlier run) or "learned"; "" = fixed.
        is_refused: Whether a learned focal length is not used, as frames fit no better with it.
    """

    scale: float
    sigma: float
    disagreement: float | None
    source: str = ""
    is_refused: bool = False


@dataclass(frozen=True)
class Estimate:
    """The result of one frame.

    Camera axes are x right, y down, z forward; lengths are in meters. The world has the axes of the
    first camera and its place as origin.

    Attributes:
        ok: Whether the motion could be estimated; otherwise `reason` says why not.
        reason: One short clause. If `ok`, the data that the estimate lacked, usually "".
        T_world_camera: 4x4 pose, maps camera coordinates to the world. If not `ok`, the last good
            one.
        T_reference_camera: 4x4 motion since the reference: the latest good frame whose estimate has
            `is_next_reference`.
        covariance: 6x6 of `T_reference_camera`, as a small motion in this camera's axes:
            translation (m), then rotation (rad). Zero for the first frame. After relocalization
            against an older frame, it covers the motion from the reference by way of that frame.
        features: Number of features.
        matches: Number of matched features.
        inliers: Number of matches that agree with the motion.
        is_reset: Whether the pose is not continuous with the previous one.
        is_next_reference: Whether this frame is the reference of the next motion.
        has_biased_error: Whether the view hardly constrains a direction: the errors of successive
            references then have one sign.
        timing: The sensor's timing; None if the odometry takes it as exact.
        focal_length: Of the color camera; None if the odometry takes it as exact.
        depth_noise_per_m: Learned standard deviation of the inverse depth of a pixel, 1/m; None if
            the odometry does not learn it, or before the first keyframe.
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
    has_biased_error: bool = False
    timing: OnlineTiming | None = None
    focal_length: OnlineFocalLength | None = None
    depth_noise_per_m: float | None = None
    debug: TrackingDebug = field(default_factory=TrackingDebug)

    def with_pose(self, T_world_camera: Array) -> "Estimate":
        """Return a copy with another pose 4x4 of the same frame."""
        T_reference_world = self.T_reference_camera @ inverse(self.T_world_camera)
        return replace(
            self,
            T_world_camera=T_world_camera,
            T_reference_camera=T_reference_world @ T_world_camera,
        )
