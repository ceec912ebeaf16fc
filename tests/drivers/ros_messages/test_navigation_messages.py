"""The CDR packer against rosbags' own reader and writer."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import rigid_transform, so3_exp
from drivers.ros_messages.cdr import split_stamp
from drivers.ros_messages.decoding import decode_odometry, decode_transform, decode_twist
from drivers.ros_messages.navigation import (
    ODOMETRY_SCHEMA,
    TRANSFORM_SCHEMA,
    TRANSFORMS_SCHEMA,
    TWIST_SCHEMA,
    OdometryMessage,
    TransformMessage,
    encode_odometry,
    encode_transform,
    encode_transforms,
    encode_twist,
)
from tests.drivers.ros_messages.rosbags_reader import check_header, frame_ids, read_with_rosbags

meters = st.floats(-1e6, 1e6)


@st.composite
def messages(draw: st.DrawFn) -> OdometryMessage:
    vector = [draw(st.floats(-3.0, 3.0)) for _ in range(3)]
    return OdometryMessage(
        stamp_s=draw(st.floats(-(2.0**31), 2.0**31 - 1)),
        frame_id=draw(frame_ids),
        child_frame_id=draw(frame_ids),
        T_frame_child=rigid_transform(so3_exp(vector), [draw(meters) for _ in range(3)]),
        pose_covariance=np.full((6, 6), draw(meters)) + np.arange(36).reshape(6, 6),
        twist=np.array([draw(meters) for _ in range(6)]),
        twist_covariance=np.full((6, 6), draw(meters)) - np.arange(36).reshape(6, 6),
    )


def example(**changes: Any) -> OdometryMessage:
    message = OdometryMessage(
        stamp_s=1305031453.359684,
        frame_id="odom",
        child_frame_id="base_link",
        T_frame_child=np.eye(4),
        pose_covariance=np.eye(6),
        twist=np.zeros(6),
        twist_covariance=np.eye(6),
    )
    return dataclasses.replace(message, **changes)


def check_frames(ros: Any, message: OdometryMessage) -> None:
    """Compare what rosbags has read with the stamp and the frames of a message."""
    check_header(ros, message.stamp_s, message.frame_id)
    assert ros.child_frame_id == message.child_frame_id


def numbers_of(*parts: Any) -> list[float]:
    """Return the numbers of vectors and quaternions that rosbags has read."""
    return [getattr(part, name) for part in parts for name in "xyzw" if hasattr(part, name)]


@given(messages())
def test_rosbags_reads_an_odometry(message: OdometryMessage) -> None:
    ros = read_with_rosbags(encode_odometry(message), ODOMETRY_SCHEMA)
    check_frames(ros, message)
    pose, twist = ros.pose, ros.twist
    assert numbers_of(pose.pose.position) == list(message.position_m)
    assert numbers_of(pose.pose.orientation) == list(message.quaternion_xyzw)
    assert numbers_of(twist.twist.linear, twist.twist.angular) == list(message.twist)
    np.testing.assert_array_equal(pose.covariance, message.pose_covariance.ravel())
    np.testing.assert_array_equal(twist.covariance, message.twist_covariance.ravel())


def transform_of(message: OdometryMessage) -> TransformMessage:
    return TransformMessage(
        message.stamp_s, message.frame_id, message.child_frame_id, message.T_frame_child
    )


def check_transform(ros: Any, message: OdometryMessage) -> None:
    check_frames(ros, message)
    assert numbers_of(ros.transform.translation) == list(message.position_m)
    assert numbers_of(ros.transform.rotation) == list(message.quaternion_xyzw)


@given(st.lists(messages(), max_size=3))
def test_rosbags_reads_one_and_several_transforms(several: list[OdometryMessage]) -> None:
    for each in several:
        encoded = encode_transform(transform_of(each))
        check_transform(read_with_rosbags(encoded, TRANSFORM_SCHEMA), each)
    together = encode_transforms([transform_of(each) for each in several])
    for ros, message in zip(
        read_with_rosbags(together, TRANSFORMS_SCHEMA).transforms, several, strict=True
    ):
        check_transform(ros, message)


@given(messages())
def test_decoding_a_transform_gives_back_what_was_encoded(message: OdometryMessage) -> None:
    decoded = decode_transform(encode_transform(transform_of(message)))
    assert decoded.stamp_s == pytest.approx(message.stamp_s, abs=1e-9)
    assert (decoded.frame_id, decoded.child_frame_id) == (message.frame_id, message.child_frame_id)
    np.testing.assert_allclose(decoded.T_frame_child, message.T_frame_child, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("where", [(1, 3), (0, 0)])
def test_a_transform_that_is_not_finite_is_never_encoded(
    bad: float, where: tuple[int, int]
) -> None:
    T = np.eye(4)
    T[where] = bad
    message = TransformMessage(1.0, "odom", "base_link", T)
    with pytest.raises(ValueError, match="not finite"):
        encode_transform(message)
    with pytest.raises(ValueError, match="not finite"):
        encode_transforms([message])


@given(messages())
def test_decoding_gives_back_what_was_encoded(message: OdometryMessage) -> None:
    decoded = decode_odometry(encode_odometry(message))
    assert decoded.stamp_s == pytest.approx(message.stamp_s, abs=1e-9)
    assert (decoded.frame_id, decoded.child_frame_id) == (message.frame_id, message.child_frame_id)
    np.testing.assert_allclose(decoded.T_frame_child, message.T_frame_child, atol=1e-12)
    np.testing.assert_array_equal(decoded.pose_covariance, message.pose_covariance)
    np.testing.assert_array_equal(decoded.twist, message.twist)
    np.testing.assert_array_equal(decoded.twist_covariance, message.twist_covariance)


def test_rosbags_reads_a_twist_and_it_is_decoded() -> None:
    twist = np.array([0.3, -0.1, 0.0, 0.0, 1e-3, -0.5])
    encoded = encode_twist(twist)
    ros = read_with_rosbags(encoded, TWIST_SCHEMA)
    assert numbers_of(ros.linear, ros.angular) == list(twist)
    np.testing.assert_array_equal(decode_twist(encoded), twist)


@pytest.mark.parametrize(
    ("stamp_s", "expected"),
    [
        (0.0, (0, 0)),
        (1.5, (1, 500_000_000)),
        (-0.25, (-1, 750_000_000)),
        (-3.0, (-3, 0)),
        (np.nextafter(2.0, 0.0), (2, 0)),
        (2147483647.5, (2147483647, 500_000_000)),
    ],
)
def test_a_stamp_splits_into_seconds_and_nanoseconds(
    stamp_s: float, expected: tuple[int, int]
) -> None:
    assert split_stamp(stamp_s) == expected


@given(st.floats(1e9, 2e9))
def test_a_unix_stamp_is_exact(stamp_s: float) -> None:
    sec, nanosec = split_stamp(stamp_s)
    assert sec + nanosec * 1e-9 == stamp_s


@pytest.mark.parametrize("stamp_s", [2.0**31, -(2.0**31) - 1, np.inf, np.nan])
def test_a_stamp_out_of_range_is_rejected(stamp_s: float) -> None:
    with pytest.raises(ValueError, match="stamp"):
        split_stamp(stamp_s)


@pytest.mark.parametrize("field", ["T_frame_child", "pose_covariance", "twist", "twist_covariance"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_never_encoded(field: str, bad: float) -> None:
    values = np.array(getattr(example(), field))
    values[np.unravel_index(3, values.shape)] = bad
    with pytest.raises(ValueError, match="not finite"):
        encode_odometry(example(**{field: values}))


@pytest.mark.parametrize("length", [0, 3, 10, 18, 40, 99])
def test_a_truncated_message_is_rejected(length: int) -> None:
    with pytest.raises(ValueError, match=r"CDR|TransformStamped"):
        decode_transform(encode_transform(transform_of(example()))[:length])
    with pytest.raises(ValueError, match=r"CDR|Odometry"):
        decode_odometry(encode_odometry(example())[:length])


def test_a_big_endian_message_is_refused() -> None:
    with pytest.raises(ValueError, match="little-endian"):
        decode_odometry(b"\x00\x00\x00\x00" + encode_odometry(example())[4:])
