"""The messages of a frame: millimeters, points where the pixels are, and images that come back."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import AccelerometerReading, PinholeCamera, RgbdFrame
from drivers.ros_messages.decoding import decode_color_jpeg, decode_depth_png
from drivers.ros_messages.sensors import CompressedImageMessage
from vo_service.outputs.frames.frame_messages import FrameMessages, depth_in_mm

CAMERA = PinholeCamera(64, 48, 50.0, 52.0, 31.5, 23.5)


@pytest.fixture
def frame() -> RgbdFrame:
    rows, columns = np.mgrid[:48, :64]
    color = np.dstack([rows * 3, columns * 2, rows + columns]).astype(np.uint8)
    depth = (1000 + 10 * rows + columns).astype(np.uint16)
    depth[:5] = 0
    return RgbdFrame(7, 5.0, 0.0, color, depth, 1000.0, CAMERA)


@pytest.fixture
def messages(frame: RgbdFrame) -> FrameMessages:
    return FrameMessages(frame, 1.0, "camera_rgb_optical_frame")


def test_depth_of_another_unit_becomes_millimeters(frame: RgbdFrame) -> None:
    tum = replace(frame, depth_raw=np.array([[0, 5, 5000, 65534]], np.uint16), depth_factor=5000.0)
    assert depth_in_mm(tum).tolist() == [[0, 1, 1000, 13107]]
    coarse = replace(tum, depth_factor=500.0)
    assert depth_in_mm(coarse).tolist() == [[0, 10, 10000, 0]]  # 131 m does not fit


def test_a_jpeg_is_close_to_the_image(messages: FrameMessages, frame: RgbdFrame) -> None:
    decoded = decode_color_jpeg(messages.color_jpeg(95))
    assert np.abs(decoded.astype(int) - frame.color_bgr).mean() < 4.0


def test_points_project_onto_their_pixels(messages: FrameMessages, frame: RgbdFrame) -> None:
    cloud = messages.points(stride=3)
    projected = cloud.xyz_m @ CAMERA.K.T
    columns, rows = np.rint(projected[:, :2] / projected[:, 2:]).astype(int).T
    assert np.all(rows % 3 == 0)
    assert np.all(columns % 3 == 0)
    np.testing.assert_allclose(cloud.xyz_m[:, 2], frame.depth_m[rows, columns])
    np.testing.assert_array_equal(cloud.bgr, frame.color_bgr[rows, columns])
    assert len(cloud.xyz_m) == np.count_nonzero(frame.depth_raw[::3, ::3])


def test_the_acceleration_has_its_own_stamp(messages: FrameMessages) -> None:
    imu = messages.imu(AccelerometerReading(4.75, (0.0, -9.8, -0.3)))
    assert imu.stamp_s == 0.75  # the frame's stamp is published as 1
    np.testing.assert_array_equal(imu.acceleration_m_s2, [0.0, -9.8, -0.3])


@pytest.mark.parametrize("data", [b"", b"\x00" * 12, b"\x00" * 40])
def test_images_that_cannot_be_decoded_are_refused(data: bytes) -> None:
    message = CompressedImageMessage(1.0, "camera", "some format", data or b"\x00")
    for decode in (decode_color_jpeg, decode_depth_png):
        with pytest.raises(ValueError, match="cannot be decoded"):
            decode(message)
