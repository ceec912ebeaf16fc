"""The map->odom transform as a client gets it, and its parser."""

import time
from dataclasses import dataclass

import zenoh

from drivers.core.geometry import Array
from vo_service.ros_messages import decode_transform
from vo_service.types import MapOdomAttachment, decode_message, parse_json_message


@dataclass(frozen=True)
class MapOdom:
    """The map->odom transform, as loop closure has corrected it.

    The transform jumps when the map is corrected, so poses in `odom` stay continuous. A pose in the
    map is ``T_map_odom @ pose.T_odom_base`` if `is_localized` holds and both epochs are equal.

    Attributes:
        stamp_s: Stamp of the newest pose at publication, Unix seconds.
        frame_id: Name of the map frame.
        child_frame_id: Name of the odom frame.
        T_map_odom: 4x4; maps coordinates of odom to the map, meters.
        seq: Number of that pose.
        epoch: Epoch of that pose.
        is_localized: False after a reset, a loss or the load of a map, until relocalization
            succeeds; until then the transform is unknown.
        map_keyframes: Number of keyframes in the map.
        loop_closures: Number of loop closures.
        receive_time_s: Time of arrival, this computer's CLOCK_MONOTONIC.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_map_odom: Array
    seq: int
    epoch: int
    is_localized: bool
    map_keyframes: int
    loop_closures: int
    receive_time_s: float

    @property
    def age_s(self) -> float:
        """Seconds since the message arrived; needs no synchronized clocks."""
        return time.monotonic() - self.receive_time_s


def parse_map_odom(sample: zenoh.Sample) -> MapOdom:
    """Parse a sample of ``map_odom``.

    Raises:
        ValueError: The message is malformed or of an unknown version.
    """
    if sample.attachment is None:
        raise ValueError("a map_odom message came without its attachment")
    content = parse_json_message(sample.attachment.to_bytes())
    attachment = decode_message(MapOdomAttachment, content, "a map_odom message")
    message = decode_transform(sample.payload.to_bytes())
    return MapOdom(
        stamp_s=message.stamp_s,
        frame_id=message.frame_id,
        child_frame_id=message.child_frame_id,
        T_map_odom=message.T_frame_child,
        **vars(attachment),
        receive_time_s=time.monotonic(),
    )
