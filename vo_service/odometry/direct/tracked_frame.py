"""A frame that was found; and how the camera moved in it, once the next one is there.

How a camera moves while a rolling shutter is open is told by the frame's rows, against a keyframe
that may be bent itself: what bends one keyframe would bend the next. The poses before and after it
were laid on the same keyframe, and all are off alike: what lies between them is not bent.
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
    """A frame, and where it was found.

    way      up to the good frame before it
    is_held  its view held the camera in all six directions
    """

    frame: RgbdFrame
    images: ImagePyramid
    result: TrackingResult
    motion_state: MotionState
    is_well_constrained: bool

    def with_vignetting(self, vignetting: float) -> "TrackedFrame":
        """The same, by what is known of the lens's light now: see `VignettingEstimate`."""
        return replace(self, images=replace(self.images, vignetting=vignetting))

    def with_motion(self, motion: Array) -> "TrackedFrame":
        """The same with another movement (9,) of the camera in its own axes, see `movement`."""
        alignment = self.result.alignment
        in_keyframe = change_frame(-motion, inverse(alignment.T_camera_keyframe))
        found = replace(self.result, alignment=replace(alignment, motion=in_keyframe))
        return replace(self, result=found)


def estimate_previous_motion(before: TrackedFrame | None, now: TrackedFrame) -> Array | None:
    """(9,) movement of the camera in the frame before, by the poses around it, see `movement`.

    None where nothing is bent, or where these tell nothing.
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
    """Whether both, and the one before them, were laid well on one keyframe, soon after another."""
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
