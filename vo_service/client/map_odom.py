"""How `odom` lies in the map, as a reader gets it, and reading that from what came over Zenoh."""

import time
from dataclasses import dataclass

import zenoh

from drivers.core.geometry import Array
from vo_service.client.message_parsing import check_fields, parse_json
from vo_service.outputs.zenoh.cdr_transform import decode_transform

_ATTACHMENT_FIELDS = {
    "seq": int,
    "epoch": int,
    "is_localized": bool,
    "map_keyframes": int,
    "loop_closures": int,
}


@dataclass(frozen=True)
class MapOdom:
    """How `odom` lies in the map: what the places that were known again say.

    It jumps where the map is corrected, so that poses in `odom` need not. A pose in the map is
    ``T_map_odom @ pose.T_odom_base``, if `is_localized` and both are of the same epoch.

    stamp_s       instant of the newest pose when it was published, Unix seconds
    frame_id, child_frame_id  names of the map's frame and of `odom`
    T_map_odom    4x4; maps coordinates of odom to the map, metres
    seq, epoch    of that pose
    is_localized    False after a reset, after a loss and where a map was loaded, until one of its
                  places is known again: then `odom` lies anywhere
    map_keyframes  how many there are
    loop_closures  how often one of them was recognized
    heard_s       when it came, on this computer's CLOCK_MONOTONIC
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
        """Seconds since it came. The clocks of two computers need not agree for this."""
        return time.monotonic() - self.receive_time_s


def parse_map_odom(sample: zenoh.Sample) -> MapOdom:
    """What a sample of ``map_odom`` says.

    Raises ValueError if it is none, or of a version that this client does not know.
    """
    if sample.attachment is None:
        raise ValueError("a place in the map came without its attachment")
    about = parse_json(sample.attachment)
    check_fields("a place in the map", about, _ATTACHMENT_FIELDS)
    message = decode_transform(sample.payload.to_bytes())
    return MapOdom(
        stamp_s=message.stamp_s,
        frame_id=message.frame_id,
        child_frame_id=message.child_frame_id,
        T_map_odom=message.T_frame_child,
        **{name: about[name] for name in _ATTACHMENT_FIELDS},
        receive_time_s=time.monotonic(),
    )
