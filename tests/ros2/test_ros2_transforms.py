"""Transforms of /tf: the same bytes as the encoder of kinect-vo makes, for any names."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kinect_vo_ros2.transforms import encode_transforms, read_transform, stamp_of

from drivers.core.geometry import rigid_transform, so3_exp
from drivers.ros_messages import navigation
from drivers.ros_messages.navigation import OdometryMessage, TransformMessage

names = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=12)
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
messages = st.builds(
    lambda stamp_s, parent, child, r, t: TransformMessage(
        stamp_s, parent, child, rigid_transform(so3_exp(r), t)
    ),
    st.floats(0.0, 2e9),
    names,
    names,
    vectors,
    vectors,
)


@given(st.lists(messages, max_size=3))
def test_transforms_are_encoded_as_kinect_vo_does(found: list[TransformMessage]) -> None:
    own = [read_transform(navigation.encode_transform(message)) for message in found]
    assert encode_transforms(own) == navigation.encode_transforms(found)


@given(messages)
def test_an_odometry_holds_the_transform_of_its_pose(message: TransformMessage) -> None:
    odometry = OdometryMessage(
        float(message.stamp_s), message.frame_id, message.child_frame_id, message.T_frame_child,
        np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6)),
    )  # fmt: skip
    payload = navigation.encode_odometry(odometry)
    assert encode_transforms([read_transform(payload)]) == navigation.encode_transforms([message])


@given(messages, messages)
def test_a_transform_gets_the_stamp_of_another_message(
    message: TransformMessage, newer: TransformMessage
) -> None:
    payload, stamp = navigation.encode_transform(message), navigation.encode_transform(newer)
    moved = read_transform(payload).at(stamp_of(stamp))
    assert moved.stamp == read_transform(stamp).stamp
    assert moved.pose == read_transform(payload).pose


@given(messages, st.integers(0, 90))
def test_a_shortened_message_is_refused(message: TransformMessage, size: int) -> None:
    payload = navigation.encode_transform(message)
    if size < len(payload):
        with pytest.raises(ValueError, match="message"):
            read_transform(payload[:size])


@given(st.binary(max_size=120))
def test_any_bytes_are_read_or_refused(payload: bytes) -> None:
    for data in (payload, b"\x00\x01\x00\x00" + payload):
        with suppress(ValueError):
            read_transform(data)
