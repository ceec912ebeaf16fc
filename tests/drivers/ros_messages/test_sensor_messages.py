"""The messages of images, points and acceleration against rosbags' own reader and writer."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.ros_messages import decoding
from drivers.ros_messages import sensors as ros
from drivers.ros_messages.cdr import CDR_HEADER, split_stamp
from tests.drivers.ros_messages.rosbags_reader import (
    check_header,
    frame_ids,
    read_with_rosbags,
    stamps,
)

sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))
numbers = st.floats(-1e6, 1e6, width=32)


@given(stamps, frame_ids, st.data(), sizes)
def test_a_color_image(stamp_s: float, frame_id: str, data: st.DataObject, size: Any) -> None:
    pixels = data.draw(arrays(np.uint8, (*size, 3)))
    message = ros.RawImageMessage(stamp_s, frame_id, "bgr8", pixels)
    encoded = ros.encode_image(message)
    read = read_with_rosbags(encoded, ros.IMAGE_SCHEMA)
    check_header(read, stamp_s, frame_id)
    assert (read.height, read.width, read.step) == (*size, 3 * size[1])
    assert (read.encoding, read.is_bigendian) == ("bgr8", 0)
    np.testing.assert_array_equal(read.data, pixels.ravel())
    decoded = decoding.decode_image(encoded)
    np.testing.assert_array_equal(decoded.pixels, pixels)
    assert (decoded.frame_id, decoded.encoding) == (frame_id, "bgr8")
    assert split_stamp(decoded.stamp_s) == split_stamp(stamp_s)


@given(stamps, frame_ids, st.data(), sizes)
def test_a_depth_image(stamp_s: float, frame_id: str, data: st.DataObject, size: Any) -> None:
    pixels = data.draw(arrays(np.uint16, size))
    message = ros.RawImageMessage(stamp_s, frame_id, "16UC1", pixels)
    encoded = ros.encode_image(message)
    decoded = read_with_rosbags(encoded, ros.IMAGE_SCHEMA)
    assert (decoded.height, decoded.width, decoded.step) == (*size, 2 * size[1])
    np.testing.assert_array_equal(decoded.data.view(np.uint16).reshape(size), pixels)
    np.testing.assert_array_equal(decoding.decode_image(encoded).pixels, pixels)


@given(stamps, frame_ids, st.binary(max_size=50))
def test_a_compressed_image(stamp_s: float, frame_id: str, data: bytes) -> None:
    text = "bgr8; jpeg compressed bgr8"
    message = ros.CompressedImageMessage(stamp_s, frame_id, text, data)
    encoded = ros.encode_compressed_image(message)
    read = read_with_rosbags(encoded, ros.COMPRESSED_IMAGE_SCHEMA)
    check_header(read, stamp_s, frame_id)
    assert (read.format, bytes(read.data)) == (text, data)
    assert bytes(decoding.decode_compressed_image(encoded).data) == data


@given(stamps, frame_ids, sizes, arrays(np.float64, (3, 3), elements=numbers))
def test_camera_info(stamp_s: float, frame_id: str, size: Any, K: Any) -> None:
    message = ros.CameraInfoMessage(stamp_s, frame_id, size[0], size[1], K)
    encoded = ros.encode_camera_info(message)
    read = read_with_rosbags(encoded, ros.CAMERA_INFO_SCHEMA)
    check_header(read, stamp_s, frame_id)
    assert (read.width, read.height, read.distortion_model) == (*size, "plumb_bob")
    np.testing.assert_array_equal(read.k, K.ravel())
    np.testing.assert_array_equal(read.p.reshape(3, 4), np.hstack([K, np.zeros((3, 1))]))
    np.testing.assert_array_equal(read.r, np.eye(3).ravel())
    assert list(read.d) == [0.0] * 5
    roi = read.roi
    assert not any((read.binning_x, read.binning_y, roi.x_offset, roi.y_offset, roi.do_rectify))
    assert (roi.width, roi.height) == (0, 0)
    np.testing.assert_array_equal(decoding.decode_camera_info(encoded).K, K)


@given(stamps, frame_ids, st.integers(0, 20), st.data())
def test_a_point_cloud(stamp_s: float, frame_id: str, count: int, data: st.DataObject) -> None:
    xyz_m = data.draw(arrays(np.float32, (count, 3), elements=numbers))
    bgr = data.draw(arrays(np.uint8, (count, 3)))
    encoded = ros.encode_point_cloud(ros.PointCloudMessage(stamp_s, frame_id, xyz_m, bgr))
    cloud = read_with_rosbags(encoded, ros.POINT_CLOUD_SCHEMA)
    assert [(field.name, field.offset) for field in cloud.fields] == [
        ("x", 0),
        ("y", 4),
        ("z", 8),
        ("rgb", 12),
    ]
    assert (cloud.height, cloud.width, cloud.point_step) == (1, count, 16)
    rows = cloud.data.reshape(count, 16)
    np.testing.assert_array_equal(rows[:, :12].copy().view(np.float32), xyz_m)
    np.testing.assert_array_equal(rows[:, 12:15], bgr)  # rgb is 0x00RRGGBB, little endian
    decoded = decoding.decode_point_cloud(encoded)
    np.testing.assert_array_equal(decoded.xyz_m, xyz_m)
    np.testing.assert_array_equal(decoded.bgr, bgr)


@given(stamps, frame_ids, arrays(np.float64, 3, elements=numbers))
def test_an_acceleration(stamp_s: float, frame_id: str, acceleration: Any) -> None:
    encoded = ros.encode_imu(ros.ImuMessage(stamp_s, frame_id, acceleration))
    imu = read_with_rosbags(encoded, ros.IMU_SCHEMA)
    assert imu.orientation_covariance[0] == imu.angular_velocity_covariance[0] == -1.0
    measured = imu.linear_acceleration
    assert [measured.x, measured.y, measured.z] == list(acceleration)


DECODERS = (
    decoding.decode_image,
    decoding.decode_compressed_image,
    decoding.decode_camera_info,
    decoding.decode_point_cloud,
    decoding.decode_transform,
    decoding.decode_odometry,
    decoding.decode_laser_scan,
    decoding.decode_occupancy_grid,
)


@pytest.mark.parametrize("decode", DECODERS)
@given(st.binary(max_size=200))
def test_any_bytes_give_a_message_or_a_value_error(
    decode: Callable[[bytes], object], body: bytes
) -> None:
    with suppress(ValueError):
        decode(CDR_HEADER + body)


@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [(np.zeros((4, 4), np.uint8), "bgr8"), (np.zeros((4, 4, 3), np.uint16), "16UC1")],
)
def test_pixels_that_do_not_fit_the_encoding_are_rejected(pixels: Any, encoding: str) -> None:
    with pytest.raises(ValueError, match="not an image"):
        ros.encode_image(ros.RawImageMessage(1.0, "camera", encoding, pixels))


def test_points_that_are_not_finite_are_never_encoded() -> None:
    xyz_m = np.array([[0.0, 0.0, np.nan]], np.float32)
    cloud = ros.PointCloudMessage(1.0, "camera", xyz_m, np.zeros((1, 3), np.uint8))
    with pytest.raises(ValueError, match="not finite"):
        ros.encode_point_cloud(cloud)


def test_a_distorted_camera_info_is_refused() -> None:
    info = ros.CameraInfoMessage(1.0, "camera_rgb_optical_frame", 640, 480, np.eye(3))
    encoded = bytearray(ros.encode_camera_info(info))
    assert len(encoded) == 381
    encoded[76:84] = np.float64(0.1).tobytes()
    with pytest.raises(ValueError, match="distorted"):
        decoding.decode_camera_info(encoded)
