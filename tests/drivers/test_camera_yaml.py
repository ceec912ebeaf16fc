"""Camera files of OpenCV, ROS and ORB-SLAM."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.calibration import CameraCalibration, read_calibration
from drivers.core import InputError

EXPECTED = CameraCalibration(
    640, 480, 517.3, 516.5, 318.6, 255.3, (0.26, -0.95, -0.005, 0.003, 1.16), 5000.0
)
ORB_SLAM2 = """\
%YAML:1.0

#---------------- Camera
Camera.fx: 517.3
Camera.fy: 516.5
Camera.cx: 318.6
Camera.cy: 255.3
Camera.k1: 0.26
Camera.k2: -0.95
Camera.p1: -0.005
Camera.p2: 0.003
Camera.k3: 1.16
Camera.width: 640
Camera.height: 480
Camera.RGB: 1
DepthMapFactor: 5000.0
"""
ORB_SLAM3 = (
    ORB_SLAM2.replace("Camera.", "Camera1.")
    .replace("Camera1.width", "Camera.width")
    .replace("Camera1.height", "Camera.height")
    .replace("DepthMapFactor", "RGBD.DepthMapFactor")
    + 'Camera.type: "PinHole"\nFile.version: "1.0"\n'
)
ROS = """\
image_width: 640
image_height: 480
camera_name: rgb_A00362A01385122A
camera_matrix:
  rows: 3
  cols: 3
  data: [517.3, 0.0, 318.6, 0.0, 516.5, 255.3, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.26, -0.95, -0.005, 0.003, 1.16]
"""
ROS_WITH_DASHES = ROS.replace(
    "  data: [0.26, -0.95, -0.005, 0.003, 1.16]",
    "  data:\n  - 0.26\n  - -0.95\n  - -0.005\n  - 0.003\n  - 1.16",
)
FACTOR = "depth_factor: 5000\n"


def write_opencv(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[517.3, 0, 318.6], [0, 516.5, 255.3], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[0.26, -0.95, -0.005, 0.003, 1.16]]))
    storage.release()
    path.write_text(path.read_text() + FACTOR)


@pytest.mark.parametrize(
    "text",
    [
        ORB_SLAM2, ORB_SLAM3, ROS + FACTOR, ROS_WITH_DASHES + FACTOR,
        ORB_SLAM2.replace("\n", "\r\n"), ORB_SLAM2.replace(": ", ":\t"), "\ufeff" + ORB_SLAM2,
        ORB_SLAM2.replace("%YAML:1.0", "%YAML:1.0\n---"),
    ],
    ids=["orb-slam2", "orb-slam3", "ros", "dashes", "windows", "tabs", "mark", "document"],
)  # fmt: skip
def test_the_camera_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "camera.yaml").write_bytes(text.encode())
    assert read_calibration(tmp_path / "camera.yaml") == EXPECTED


def test_the_camera_that_opencv_wrote_is_read(tmp_path: Path) -> None:
    write_opencv(tmp_path / "camera.YML")
    assert read_calibration(tmp_path / "camera.YML") == EXPECTED


def test_a_missing_depth_factor_is_millimeters_with_a_warning_or_the_recordings(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "ros.yaml").write_text(ROS)
    with caplog.at_level(logging.WARNING):
        assert read_calibration(tmp_path / "ros.yaml", 5000.0) == EXPECTED
        assert not caplog.records
        assert read_calibration(tmp_path / "ros.yaml").depth_factor == 1000.0
    assert "ros.yaml: has no depth factor: depth in millimeters is assumed" in caplog.text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "FILE: has no camera; a camera file in YAML has camera_matrix"),
        ("a: 1\nfoo bar\n", "FILE:2: not YAML"),
        ("%YAML:1.0\nfoo bar\n", "FILE:2: not YAML"),
        (ORB_SLAM2.replace("Camera.fy: 516.5\n", ""), "FILE: key `Camera.fy` is missing"),
        (ORB_SLAM2.replace("Camera.width: 640\n", ""), "FILE: key `Camera.width` is missing"),
        (ORB_SLAM2.replace("517.3", "abc"), 'FILE: key `fx`: "abc" is the wrong type; give a num'),
        (ORB_SLAM2.replace("517.3", ".Nan"), "FILE: key `fx`: nan is not allowed"),
        (ORB_SLAM2.replace("640", "6e9"), "FILE: key `width`: "),
        (ORB_SLAM3.replace("PinHole", "KannalaBrandt8"), "FILE: the lens model kannalabrandt8 is"),
        (ROS.replace("plumb_bob", "equidistant"), "FILE: the lens model equidistant is not"),
        (ROS.replace("1.16]", "1.16, 0.1, 0, 0]"), "FILE: key `distortion_coefficients`: has 8"),
        (ROS.replace(", 0, 0, 1]", "]"), "FILE: key `camera_matrix`: has 6 numbers; give 9"),
        (ROS.replace("  data: [5", "  date: [5"), "FILE: key `camera_matrix`: is not a matrix"),
        (ROS.replace("image_height: 480\n", ""), "FILE: key `image_height` is missing"),
        (b"# \xff", "FILE:1: is not UTF-8 text"),
    ],
)
def test_faults_name_the_key(tmp_path: Path, text: str | bytes, expected: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read_calibration(file)
    message = str(caught.value)
    assert "\n" not in message
    assert message.replace(str(file), "FILE").startswith(expected)


@given(st.text(max_size=60), st.integers(0, len(ROS)))
def test_any_text_is_a_camera_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, text: str, position: int
) -> None:
    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.write_text(ROS[:position] + text + ROS[position:], errors="replace")
    try:
        camera = read_calibration(file, 1000.0)
    except InputError:
        return
    assert camera.fx >= 1.0
