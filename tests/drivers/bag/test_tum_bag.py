"""A bag as the TUM benchmark has them: bz2 chunks, depth in meters, tf/tfMessage, old names."""

from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import TUM_CALIBRATIONS
from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from tests.drivers.bag.bag_maker import (
    IMAGE,
    INFO,
    color_image,
    depth_mm,
    open_writer,
    stamp_ns,
    stamp_s,
)

COUNT = 8
OPTICAL = "/openni_rgb_optical_frame"


@pytest.fixture(scope="module")
def tum_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tum") / "rgbd_dataset_desk.bag"
    with open_writer(path) as bag:
        make = bag.maker
        for k in range(COUNT):
            t = stamp_ns(k)
            bgr, meters = color_image(k), depth_mm(k) / np.float32(1000)
            meters[meters == 0] = np.nan
            color = make.image(t, np.ascontiguousarray(bgr[..., ::-1]), "rgb8", OPTICAL)
            depth = make.image(t + 4_000_000, meters, "32FC1", OPTICAL)
            bag.write("/camera/rgb/camera_info", INFO, t, make.info(t))
            bag.write("/camera/depth/image", IMAGE, t + 4_000_000, depth)
            bag.write("/camera/rgb/image_color", IMAGE, t + 9_000_000, color)
            bag.transforms(
                "/tf", t, "tf/msg/tfMessage",
                make.transform(t, "/world", "/kinect", (0.1 * k, 0.0, 1.0)),
                make.transform(t, "/kinect", "/openni_camera", (0.0, 0.02, 0.0)),
                make.transform(t, "/openni_camera", OPTICAL, (0.0, 0, 0), (-0.5, 0.5, -0.5, 0.5)),
            )  # fmt: skip
    return path


def test_every_frame_is_read(tum_bag: Path) -> None:
    with RecordingCamera(tum_bag) as camera:
        frames = list(camera)
    assert len(frames) == COUNT
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.color_bgr, color_image(k))
        np.testing.assert_array_equal(frame.depth_raw, 5 * depth_mm(k).astype(int))
        assert frame.stamp_s == stamp_s(k)
        assert frame.skew_s == 0.004
    assert frames[0].depth_factor == 5000.0
    assert (frames[0].camera.fx, frames[0].camera.cx) == (60.0, 31.5)


def test_the_true_motion_of_the_color_camera_comes_from_tf(tum_bag: Path) -> None:
    truth = open_recording(tum_bag).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.stamps_s, [stamp_s(k) for k in range(COUNT)])
    np.testing.assert_allclose(truth.T_world_camera[3, :3, 3], [0.3, 0.02, 1.0])
    np.testing.assert_allclose(truth.T_world_camera[3, :3, 2], [1, 0, 0], atol=1e-12)


def test_what_was_found_is_named_in_one_line(tum_bag: Path) -> None:
    assert open_recording(tum_bag).summary == (
        f"{tum_bag}: color /camera/rgb/image_color, depth /camera/depth/image, camera "
        "/camera/rgb/camera_info, ground truth /tf (world to openni_rgb_optical_frame)"
    )


def test_a_bag_of_the_benchmark_has_its_published_camera(tmp_path: Path) -> None:
    path = tmp_path / "rgbd_dataset_freiburg1_xyz.bag"
    with open_writer(path) as bag:
        make, t = bag.maker, stamp_ns(0)
        color, depth = np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32)
        bag.write("/camera/rgb/camera_info", INFO, t, make.info(t, focal_px=525.0, size=(640, 480)))
        bag.write("/camera/rgb/image_color", IMAGE, t, make.image(t, color, "rgb8"))
        bag.write("/camera/depth/image", IMAGE, t, make.image(t, depth, "32FC1"))
    recording = open_recording(path)
    assert recording.calibration == TUM_CALIBRATIONS["1"]
    assert "camera of the benchmark, by the file's name" in recording.summary
