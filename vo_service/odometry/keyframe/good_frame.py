"""A frame that was found; and how the camera moved in it, once the next one is there.

How a camera moves while a rolling shutter is open is told by the frame's rows, against a keyframe
that may be bent itself: what bends one keyframe would bend the next. The poses before and after it
were laid on the same keyframe, and all are off alike: what lies between them is not bent.
"""

from dataclasses import dataclass, replace

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.movement import in_axes, through
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.way import Way


@dataclass(frozen=True)
class GoodFrame:
    """A frame, and where it was found.

    way      up to the good frame before it
    is_held  its view held the camera in all six directions
    """

    frame: RgbdFrame
    images: Images
    found: Found
    way: Way
    is_held: bool

    def with_falloff(self, falloff: float) -> "GoodFrame":
        """The same, by what is known of the lens's light now: see `Falloff`."""
        return replace(self, images=replace(self.images, falloff=falloff))

    def with_movement(self, movement: Array) -> "GoodFrame":
        """The same with another movement (9,) of the camera in its own axes, see `movement`."""
        alignment = self.found.alignment
        in_keyframe = in_axes(-movement, inverse(alignment.T_camera_keyframe))
        found = replace(self.found, alignment=replace(alignment, movement=in_keyframe))
        return replace(self, found=found)


def movement_before(before: GoodFrame | None, now: GoodFrame) -> Array | None:
    """(9,) movement of the camera in the frame before, by the poses around it, see `movement`.

    None where nothing is bent, or where these tell nothing.
    """
    if before is None or now.images.shutter.is_instant or not _are_alike(before, now):
        return None
    poses = before.way.T_world_camera, before.found.T_world_camera, now.found.T_world_camera
    return through(poses, (before.way.stamp_s, before.images.stamp_s, now.images.stamp_s))


def _are_alike(before: GoodFrame, now: GoodFrame) -> bool:
    """Whether both, and the one before them, were laid well on one keyframe, soon after another."""
    return (
        before.found.keyframe is now.found.keyframe
        and before.is_held
        and now.is_held
        and not before.way.is_carried_on
        and not before.found.lack
        and before.way.is_soon(before.images.stamp_s)
        and now.way.is_soon(now.images.stamp_s)
        and not before.way.is_long_ago(now.images.stamp_s)
    )
