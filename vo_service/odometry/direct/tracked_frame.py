"""A tracked frame, and the motion of the camera in it once the next frame is tracked.

With a rolling shutter, the motion within a frame follows from its rows, aligned with a keyframe
that may itself be distorted; each keyframe would pass its distortion on to the next. The poses
before and after the frame have the same error, as they use the same keyframe, so it cancels in
between.
"""

from dataclasses import dataclass, replace

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.rolling_shutter import change_frame, fit_through_poses


@dataclass(frozen=True)
class TrackedFrame:
    """A frame and its alignment.

    Attributes:
        frame: The frame.
        images: Its image pyramid.
        result: Its alignment with a keyframe.
        motion_state: The state at the good frame before it.
        is_well_constrained: Whether its view constrains all six degrees of freedom.
    """

    frame: RgbdFrame
    images: ImagePyramid
    result: TrackingResult
    motion_state: MotionState
    is_well_constrained: bool

    def with_vignetting(self, vignetting: float) -> "TrackedFrame":
        """Return a copy with the current `VignettingEstimate`."""
        return replace(self, images=replace(self.images, vignetting=vignetting))

    def with_motion(self, motion: Array) -> "TrackedFrame":
        """Return a copy with another motion (9,) of the camera in its own axes."""
        alignment = self.result.alignment
        in_keyframe = change_frame(-motion, inverse(alignment.T_camera_keyframe))
        result = replace(self.result, alignment=replace(alignment, motion=in_keyframe))
        return replace(self, result=result)


def estimate_previous_motion(before: TrackedFrame | None, now: TrackedFrame) -> Array | None:
    """Estimate the camera's motion (9,) in the frame before, from the poses around it.

    Returns None without a rolling shutter, or if the frames are not comparable.
    """
    if before is None or now.images.shutter.is_instant or not _are_comparable(before, now):
        return None
    poses = (
        before.motion_state.T_world_camera,
        before.result.T_world_camera,
        now.result.T_world_camera,
    )
    return fit_through_poses(
        poses, (before.motion_state.stamp_s, before.images.stamp_s, now.images.stamp_s)
    )


def _are_comparable(before: TrackedFrame, now: TrackedFrame) -> bool:
    """Whether both frames and the one before are well aligned with one keyframe, soon after."""
    return (
        before.result.keyframe is now.result.keyframe
        and before.is_well_constrained
        and now.is_well_constrained
        and not before.motion_state.is_extrapolated
        and not before.result.degradation
        and before.motion_state.is_recent(before.images.stamp_s)
        and now.motion_state.is_recent(now.images.stamp_s)
        and not before.motion_state.is_stale(now.images.stamp_s)
    )
