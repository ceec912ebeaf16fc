"""The odometry's estimate of a frame, and the update that the service publishes of it.

Beside it: commands, messages and the protocols of outputs. Every part may import this package; it
imports none of them.
"""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array


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
    timing: OnlineTiming | None = None
    focal_length: OnlineFocalLength | None = None
    depth_noise_per_m: float | None = None
    debug: TrackingDebug = field(default_factory=TrackingDebug)


class Odometry(Protocol):
    """An estimator of the camera's motion; each method of `METHODS` is one."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose at this frame; frames come in the order of their stamps.

        Never raises for what the camera sees: `Estimate.ok` is then False.
        """
        ...


class StageTimer(Protocol):
    """Timer of the stages of one frame: ``with timer.stage("surf"): ...``."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        ...


class NullStageTimer:
    """Timer that measures nothing."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Do nothing."""
        return nullcontext()


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The pose graph at one time. Immutable: a changed map is a new object.

    Attributes:
        T_map_odom: 4x4 transform of `odom` in the map, from the loop closures.
        T_map_keyframe: (N, 4, 4) optical camera at each keyframe, in REP 103 axes of the map; the
            newest is the last.
        edges: (M, 2) int32, pairs of rows of `T_map_keyframe`.
        is_loop_closure: (M,) bool: whether the edge is a loop closure, not odometry.
        is_localized: Whether `T_map_odom` is known. False from the load of a map, or a loss, until
            relocalization in the map.
        epoch: Epoch of the poses that `T_map_odom` is valid for. After a `reset`, the map follows
            some frames later.
    """

    T_map_odom: Array = field(default_factory=lambda: np.eye(4))
    T_map_keyframe: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    edges: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    is_loop_closure: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    is_localized: bool = True
    epoch: int = 0

    @property
    def keyframes(self) -> int:
        """Number of keyframes."""
        return len(self.T_map_keyframe)

    @property
    def loop_closures(self) -> int:
        """Number of loop closures."""
        return int(np.count_nonzero(self.is_loop_closure))


NO_MAP = MapSnapshot()


class TrackingState(StrEnum):
    """Tracking state: how reliable a pose is."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"
    NO_CAMERA = "no_camera"


class LevelSource(StrEnum):
    """Source of the up direction of `odom`."""

    GRAVITY = "gravity"  # measured by an accelerometer at the first frame
    ASSUMED = "assumed"  # the base's first pose counts as level


@dataclass(frozen=True)
class OdometryUpdate:
    """The result of one frame, as it goes to the outputs.

    Attributes:
        seq: Number of the update, from 0.
        stamp_s: The frame's stamp on the published clock, s (Unix time if live).
        state: Tracking state: how reliable the pose is.
        reason: Reason of the state; "" if tracking.
        epoch: Changes whenever the pose is not continuous with the previous one.
        T_world_camera: 4x4, optical axes; the world is the first camera. For trajectory files and
            viewers.
        T_odom_base: 4x4 pose of the base in `odom`, REP 103 axes. For robots.
        T_odom_camera: 4x4 pose of the optical camera in `odom`. For the mapper.
        pose_covariance: 6x6, accumulated since the start of the epoch, in axes of `odom`, ROS order
            (x y z rx ry rz).
        twist: (6,) velocity in the child frame, m/s and rad/s, ROS order.
        twist_covariance: 6x6 of this step, in the child frame, ROS order.
        frame: The frame.
        estimate: The odometry's estimate of it.
        stage_ms: CPU time by stage, ms.
        latency_s: Time from the frame's arrival to this result, s.
        map: The pose graph, with the transform of `odom` in the map.
    """

    seq: int
    stamp_s: float
    state: TrackingState
    reason: str
    epoch: int
    T_world_camera: Array
    T_odom_base: Array
    T_odom_camera: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array
    frame: RgbdFrame
    estimate: Estimate
    stage_ms: Mapping[str, float]
    latency_s: float
    map: MapSnapshot = NO_MAP

    @property
    def is_localized(self) -> bool:
        """Whether the transform of this pose's `odom` in the map is known; True without a map.

        A map from before the present epoch does not have it.
        """
        the_map = self.map
        return the_map is NO_MAP or (the_map.is_localized and the_map.epoch == self.epoch)
