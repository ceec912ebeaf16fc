"""Bags whose camera_info or depth cannot be right are refused, with the topic and what to do."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.calibration import DepthCameraCalibration, RigidTransform, format_calibration
from drivers.plausibility import PlausibilityCheck
from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from tests.drivers.bag.bag_maker import (
    FRAME,
    IMAGE,
    INFO,
    SIZE,
    BagWriter,
    stamp_ns,
)
from tests.drivers.bag.test_bag import (
    DEPTH_TOPIC,
    INFO_TOPIC,
    complaint,
    make_bag,
    write_color,
    write_frame,
)
from tests.drivers.conftest import CAMERA
from vo_service.tools.convert import OutputFormat, convert

BESIDE = RigidTransform((-0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
DEPTH_CAMERA = DepthCameraCalibration(66.0, 66.0, 31.5, 23.5, BESIDE, width=64, height=48)
OWN_TOPIC, OWN_INFO_TOPIC = "/camera/depth/image_raw", "/camera/depth/camera_info"


def make_depth_bag(path: Path, depth: Any, encoding: str) -> Path:
    return make_bag(path, partial(write_frame, depth=depth, encoding=encoding))


def make_own_depth_bag(path: Path, frame: str, focal_px: float) -> Path:
    """Depth with a camera_info of its own; color has 60 pixels."""

    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        t, depth = stamp_ns(k), np.full(SIZE[::-1], 1000, np.uint16)
        bag.write(OWN_INFO_TOPIC, INFO, t, bag.maker.info(t, focal_px, frame=frame))
        bag.write(OWN_TOPIC, IMAGE, t, bag.maker.image(t, depth, "16UC1", frame))

    return make_bag(path, fill)


def test_a_focal_length_in_millimeters_is_refused_with_its_topic(tmp_path: Path) -> None:
    K_mm = np.array([3.6, 0, 31.5, 0, 3.6, 23.5, 0, 0, 1.0])
    text = complaint(make_bag(tmp_path / "a", partial(write_frame, info={"k": K_mm})))
    assert text.startswith(f"BAG: {INFO_TOPIC}: fx = 3.6 pixels is a field of view of")
    assert "about 52" in text
    assert text.endswith("--camera-file FILE replaces the topic")


def test_floats_in_millimeters_are_refused(tmp_path: Path) -> None:
    depth = np.full(SIZE[::-1], 1900.0, np.float32)
    depth[:4] = np.nan
    text = complaint(make_depth_bag(tmp_path / "a", depth, "32FC1"))
    assert DEPTH_TOPIC in text
    assert "32FC1 is depth in meters, but the median is 1900; write millimeters as 16UC1" in text
    assert "1.9 m" in text


def depth_warning(path: Path, depth: Any, encoding: str) -> str:
    """The warning about the first frame of a bag."""
    with RecordingCamera(make_depth_bag(path, depth, encoding)) as camera:
        check = PlausibilityCheck(camera)
        check.add(next(iter(camera)))
    return check.warning


def test_floats_in_meters_have_no_unit_to_doubt(tmp_path: Path) -> None:
    depth = np.full(SIZE[::-1], 0.3, np.float32)  # near for the factor 5000 of the conversion
    assert depth_warning(tmp_path / "a", depth, "32FC1") == ""


def test_depth_in_another_unit_is_named_with_its_topic(tmp_path: Path) -> None:
    warning = depth_warning(tmp_path / "a", np.full(SIZE[::-1], 9000, np.uint16), "16UC1")
    assert f"depth_factor = 1000 ({DEPTH_TOPIC}) gives a median depth of 9 m" in warning
    assert "depth_factor = 5000 in a camera file would give 1.8 m" in warning


def test_65535_is_no_reading_and_conversions_keep_it(tmp_path: Path) -> None:
    depth = np.full(SIZE[::-1], 1500, np.uint16)
    depth[:10] = 65535
    bag, folder = make_depth_bag(tmp_path / "a", depth, "16UC1"), tmp_path / "folder"
    convert(open_recording(bag), folder, OutputFormat.FOLDER, lambda count: None)
    np.testing.assert_array_equal(open_recording(folder).frames.pairs[0].depth.read_depth(), depth)
    for path in (bag, folder):
        with RecordingCamera(path) as camera:
            assert set(np.unique(next(iter(camera)).depth_raw)) == {0, 1500}


@pytest.mark.parametrize("frame", ["", FRAME])
def test_depth_of_another_camera_in_the_same_frame_is_refused(tmp_path: Path, frame: str) -> None:
    text = complaint(make_own_depth_bag(tmp_path / "a", frame, focal_px=66.0))
    assert f"{OWN_INFO_TOPIC} has fx = 66" in text
    assert f"{INFO_TOPIC} has fx = 60" in text
    assert "--camera-file FILE, with a table [depth] unless depth is registered" in text


@pytest.mark.parametrize("depth", [None, DEPTH_CAMERA])
def test_a_camera_file_says_whether_depth_is_registered(
    tmp_path: Path, depth: DepthCameraCalibration | None
) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(format_calibration(replace(CAMERA, depth=depth)))
    bag = make_own_depth_bag(tmp_path / "a", FRAME, focal_px=66.0)
    assert open_recording(bag, file).depth_camera == depth


def test_a_calibrated_color_camera_and_default_depth_are_the_same_camera(tmp_path: Path) -> None:
    bag = make_own_depth_bag(tmp_path / "a", FRAME, focal_px=61.0)
    assert open_recording(bag).depth_camera is None
