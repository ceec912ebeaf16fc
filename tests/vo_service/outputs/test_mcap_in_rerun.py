"""An MCAP file in Rerun: what its own importer makes of the messages."""

import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import AccelerometerReading, PlaybackMode, RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, Array, Trajectory, rigid_transform
from drivers.recording.frame_recorder import FrameRecorder
from tests.vo_service.outputs.rerun.rerun_recording import count_rows, read_column
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.outputs.mcap_recording import open_mcap_recording
from vo_service.outputs.rerun.web_viewer_server import no_telemetry_environment, rerun_binary

pytestmark = [pytest.mark.rerun, pytest.mark.subprocess]

DEPTH, COLOR = "/camera/depth_registered/image_raw", "/camera/rgb/image_raw/compressed"
READING = AccelerometerReading(1.0, (0.0, -9.8, 0.0))


def import_into_rerun(mcap: Path) -> Path:
    rrd = mcap.with_suffix(".rrd")
    command = [str(rerun_binary()), "mcap", "convert", str(mcap), "-o", str(rrd)]
    environment = {**os.environ, **no_telemetry_environment(mcap.parent)}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100)
    assert result.returncode == 0, result.stderr
    return rrd


def true_motion(frames: list[RgbdFrame]) -> Trajectory:
    shifts = [[0.1 * k, 0.0, 0.0] for k in range(len(frames))]
    poses = [rigid_transform(np.eye(3), shift) @ T_BODY_CAMERA for shift in shifts]
    return Trajectory(np.array([frame.stamp_s for frame in frames]), np.array(poses))


def edges(rrd: Path, topic: str) -> set[tuple[str, str]]:
    parents = read_column(rrd, topic, "Transform3D:parent_frame")
    children = read_column(rrd, topic, "Transform3D:child_frame")
    return {(p, c) for (p,), (c,) in zip(parents, children, strict=True)}


def last(rrd: Path, entity: str, component: str) -> Any:
    return read_column(rrd, entity, component)[-1]


@pytest.fixture
def frames() -> list[RgbdFrame]:
    return [
        replace(make_update(k).frame, depth_factor=1000.0, accelerometer=(READING,))
        for k in range(4)
    ]


@pytest.fixture
def rrd(frames: list[RgbdFrame], tmp_path: Path) -> Path:
    """An MCAP file of the frames, as Rerun imports it."""
    with FrameRecorder(McapRecordingFile(tmp_path / "a.mcap"), true_motion(frames)) as recorder:
        for frame in frames:
            recorder.write(frame)
    return import_into_rerun(tmp_path / "a.mcap")


def test_depth_and_color_of_a_recording_are_images(rrd: Path, frames: list[RgbdFrame]) -> None:
    depths = read_column(rrd, DEPTH, "DepthImage:buffer")
    for (buffer,), frame in zip(depths, frames, strict=True):
        np.testing.assert_array_equal(np.uint8(buffer), frame.depth_raw.view(np.uint8).ravel())
    ((depth_format,),) = read_column(rrd, DEPTH, "DepthImage:format")[:1]
    assert (depth_format["width"], depth_format["height"]) == frames[0].depth_raw.shape[::-1]
    assert len(read_column(rrd, COLOR, "EncodedImage:blob")) == len(frames)


def test_images_are_placed_by_one_camera_in_a_connected_tree(rrd: Path) -> None:
    camera_infos = [each for each in count_rows(rrd) if each.endswith("camera_info")]
    assert camera_infos == ["/camera/rgb/camera_info"]
    (plane,) = last(rrd, camera_infos[0], "Pinhole:child_frame")
    assert last(rrd, DEPTH, "CoordinateFrame:frame") == [plane]
    assert last(rrd, COLOR, "CoordinateFrame:frame") == [plane]
    (camera,) = last(rrd, camera_infos[0], "Pinhole:parent_frame")
    assert edges(rrd, "/tf_static") == {("base_link", camera)}
    assert edges(rrd, "/tf") == {("world", "base_link")}


def test_nothing_beside_the_images_hides_them(rrd: Path) -> None:
    # Else the view of /camera is empty, with an error.
    names = {
        tuple(frame)
        for entity in count_rows(rrd)
        if entity.startswith("/camera/")
        for frame in read_column(rrd, entity, "CoordinateFrame:frame")
    }
    assert names == {("camera_rgb_optical_frame_image_plane",)}
    assert read_column(rrd, "/imu", "Scalars:scalars")


def test_the_true_motion_is_shown_as_a_path(rrd: Path) -> None:
    assert last(rrd, "/ground_truth/path", "CoordinateFrame:frame") == ["world"]
    np.testing.assert_allclose(
        read_column(rrd, "/ground_truth/path", "Points3D:positions")[0], [[0.0, 0.0, 0.0]]
    )
    positions: Array = np.array(read_column(rrd, "/tf", "Transform3D:translation"))[:, 0]
    np.testing.assert_allclose(np.sort(positions[:, 0]), 0.1 * np.arange(4), atol=1e-6)


def test_the_poses_of_a_run_are_a_path_in_the_tree_of_the_ground_truth(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(30)]
    truth = true_motion([update.frame for update in updates])
    output = open_mcap_recording(
        tmp_path / "a.mcap", PlaybackMode.LOCKSTEP, ground_truth=lambda: truth
    )
    for update in updates:
        output.on_update(update)
    output.close()
    rrd = import_into_rerun(tmp_path / "a.mcap")
    assert edges(rrd, "/tf") == {("odom", "base_link"), ("odom", "world")}
    assert last(rrd, "/vo/path", "CoordinateFrame:frame") == ["odom"]
    path = np.array(last(rrd, "/vo/path", "Points3D:positions"))
    near = [np.abs(path[-1] - each.T_odom_base[:3, 3]).max() < 1e-5 for each in updates]
    assert any(near[15:])
