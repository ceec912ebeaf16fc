"""ROS 2's ``TransformStamped`` and ``TFMessage`` as plain CDR bytes, without ROS."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose
from vo_service.outputs.zenoh.cdr_encoding import (
    CDR_HEADER,
    append_frames,
    append_length,
    append_numbers,
    read_frames,
    read_numbers,
    reraise_as_value_error,
    strip_header,
)

TRANSFORM_SCHEMA = "geometry_msgs/msg/TransformStamped"

# translation 3, quaternion 4
_NUMBERS = 7


@dataclass(frozen=True)
class TransformMessage:
    """Transform between two frames.

    Attributes:
        stamp_s: stamp of the transform, Unix seconds.
        frame_id: parent frame.
        child_frame_id: child frame.
        T_frame_child: 4x4, meters.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array

    @property
    def translation_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        translation: Array = self.T_frame_child[:3, 3]
        return translation

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_transform(message: TransformMessage) -> bytes:
    """Encode a ``TransformStamped`` as CDR.

    Raises:
        ValueError: a number is not finite, or the stamp does not fit.
    """
    return CDR_HEADER + _append_transform(b"", message)


def encode_transforms(messages: Sequence[TransformMessage]) -> bytes:
    """Encode transforms as one ``TFMessage``. Raises as `encode_transform`."""
    body = append_length(b"", len(messages))
    for message in messages:
        body = _append_transform(body, message)
    return CDR_HEADER + body


def decode_transform(payload: bytes) -> TransformMessage:
    """Decode a message from `encode_transform` or any ROS 2 node.

    Raises:
        ValueError: the bytes are not a little-endian TransformStamped message.
    """
    body = strip_header(payload)
    with reraise_as_value_error(TRANSFORM_SCHEMA):
        stamp_s, frame_id, child_frame_id, offset = read_frames(body)
        numbers = read_numbers(body, offset, _NUMBERS)
        T_frame_child = transform_from_pose(numbers[:3], numbers[3:])
    return TransformMessage(stamp_s, frame_id, child_frame_id, T_frame_child)


def _append_transform(body: bytes, message: TransformMessage) -> bytes:
    if not np.all(np.isfinite(message.T_frame_child)):
        raise ValueError(f"transform at {message.stamp_s} s has a number that is not finite")
    body = append_frames(body, message.stamp_s, message.frame_id, message.child_frame_id)
    numbers = np.concatenate([message.translation_m, message.quaternion_xyzw])
    return append_numbers(body, numbers)
