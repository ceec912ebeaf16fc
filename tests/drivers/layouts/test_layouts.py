"""Folders of other benchmarks: recognized, read, and told what is missing."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, rigid_transform, so3_exp
from drivers.layouts import open_folder
from drivers.playback.camera import RecordingCamera
from drivers.playback.frame_reader import FrameReader
from drivers.recording.recording import Recording
from tests.drivers.layouts.layout_writers import WRITERS, Frame, save, write_redwood

FRAMES = 4


def true_pose(number: int) -> Array:
    return rigid_transform(so3_exp([0.1 * number, 0.2, -0.05 * number]), [0.1 * number, 0.2, 0.3])


def make_frame(number: int) -> Frame:
    """Make a plane at 2 m with a block at 1 m in its middle, and a column without a reading."""
    color = np.full((480, 640, 3), 40 + number, np.uint8)
    depth = np.full((480, 640), 2000, np.uint16)
    color[200:280, 280:360] = 200
    depth[200:280, 280:360] = 1000
    depth[:, :10] = 0
    return color, depth, true_pose(number)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder per layout."""
    folder = tmp_path_factory.mktemp("layouts")
    frames = [make_frame(number) for number in range(FRAMES)]
    for name, write in WRITERS.items():
        write(folder / name, frames)
    return folder


@pytest.fixture
def copied(written: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Copy a folder of a layout, to be damaged."""
    return lambda name: shutil.copytree(written / name, tmp_path / name)


def first_frame(recording: Recording) -> RgbdFrame:
    return FrameReader(recording).read(recording.frames.pairs[0], 0)


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_folder(folder, None)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(str(folder), "DIR")


@pytest.mark.parametrize("name", WRITERS)
def test_frames_are_stamped_at_30_hz_and_the_line_says_so(written: Path, name: str) -> None:
    recording = open_folder(written / name, None)
    assert np.allclose(np.diff(recording.frames.stamps_s), 1 / 30, atol=1e-6)
    assert len(recording.frames.pairs) == FRAMES
    assert recording.frames.stamps_s[0] == 0.0
    assert recording.summary.startswith(f"{written / name}: layout of {name}: ")
    assert "stamps at 30 Hz (assumed)" in recording.summary


@pytest.mark.parametrize(
    ("name", "size", "focal_px", "center_px"),
    [
        ("ICL-NUIM", (640, 480), (481.2, 480.0), (319.5, 239.5)),
        ("7-Scenes", (640, 480), (525.0, 525.0), (320.0, 240.0)),
        ("Redwood", (640, 480), (525.0, 525.0), (319.5, 239.5)),
        ("ScanNet", (1280, 960), (1050.0, 1050.0), (639.5, 479.5)),
    ],
)
def test_depth_is_in_meters_and_the_camera_is_the_layouts(
    written: Path, name: str, size: tuple[int, int], focal_px: tuple[float, float],
    center_px: tuple[float, float],
) -> None:  # fmt: skip
    frame = first_frame(open_folder(written / name, None))
    camera = frame.camera
    assert (camera.width, camera.height) == size
    assert ((camera.fx, camera.fy), (camera.cx, camera.cy)) == (focal_px, center_px)
    assert frame.depth_m.shape == size[::-1]
    assert frame.depth_m[size[1] // 4, size[0] // 2] == pytest.approx(2.0)
    assert frame.depth_m[size[1] // 2, size[0] // 2] == pytest.approx(1.0)
    assert frame.depth_m.max() < 2.1  # no 65535
    assert (frame.depth_m[:, : size[0] // 100] == 0).mean() > 0.9


@pytest.mark.parametrize(
    ("name", "numbers"),
    [("ICL-NUIM", [1, 2, 3]), ("Redwood", [0, 1, 2, 3]), ("ScanNet", [0, 2, 3])],
)
def test_true_poses_belong_to_their_frames(written: Path, name: str, numbers: list[int]) -> None:
    recording = open_folder(written / name, None)
    truth = recording.ground_truth
    assert truth is not None
    expected_s = recording.frames.stamps_s[numbers]
    np.testing.assert_allclose(truth.stamps_s, expected_s, rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        truth.T_world_camera, [true_pose(number) for number in numbers], rtol=0, atol=1e-6
    )


def test_seven_scenes_registers_depth_and_moves_the_poses_to_the_color_camera(
    written: Path,
) -> None:
    recording = open_folder(written / "7-Scenes", None)
    depth_m = first_frame(recording).depth_m
    # A block 80 pixels wide at 585 px, seen at 525 px and 25 mm further right, at 1 m.
    columns = np.flatnonzero(depth_m[240] == 1.0)
    assert columns[0] == pytest.approx(320 - 40 * 525 / 585 - 0.025 * 525, abs=1.5)
    assert columns[-1] == pytest.approx(320 + 39 * 525 / 585 - 0.025 * 525, abs=1.5)
    truth = recording.ground_truth
    assert truth is not None
    np.testing.assert_allclose(
        truth.T_world_camera[2] @ [-0.025, 0, 0, 1], true_pose(2) @ [0, 0, 0, 1], atol=1e-9
    )


def test_frames_without_a_pose_are_counted(written: Path) -> None:
    assert "frames without a pose: 1" in open_folder(written / "ScanNet", None).summary


def test_scannets_info_file_gives_the_cameras(copied: Callable[[str], Path]) -> None:
    folder = copied("7-Scenes")
    K = "{0} 0 {1} 0 0 {0} {2} 0 0 0 1 0 0 0 0 1"
    info = {
        "m_colorWidth": 640, "m_colorHeight": 480, "m_depthWidth": 640, "m_depthHeight": 480,
        "m_depthShift": 500, "m_calibrationColorIntrinsic": K.format(600, 319, 239),
        "m_calibrationDepthIntrinsic": K.format(570, 319, 239),
        "m_calibrationDepthExtrinsic": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    }  # fmt: skip
    text = "".join(f"{key} = {value}\n" for key, value in info.items())
    (folder / "_info.txt").write_text(text)
    recording = open_folder(folder, None)
    frame = first_frame(recording)
    assert (frame.camera.fx, frame.depth_m[100, 320]) == (600.0, pytest.approx(4.0))
    assert recording.depth_camera is not None
    assert recording.depth_camera.fx == 570.0
    for damaged, expected in (
        (text.replace("m_depthShift = 500\n", ""), "key m_depthShift is missing"),
        (text.replace("570", "x"), "key m_calibrationDepthIntrinsic is missing or wrong"),
        (text.replace("= 1 0 0 0 0 1 0", "= 1 0 0 9 0 1 0"), "is not the identity"),
    ):
        (folder / "_info.txt").write_text(damaged)
        assert expected in complaint(folder)


def test_redwood_takes_open3ds_camera_and_the_stamps_in_names(tmp_path: Path) -> None:
    color, depth, _ = make_frame(0)
    for number, stamp_us in enumerate((0, 33369, 66738), 1):
        save(tmp_path / f"rgb/{number:07d}-{stamp_us:012d}.jpg", color)
        save(tmp_path / f"depth/{number:07d}-{stamp_us + 5000:012d}.png", depth)
    (tmp_path / "camera_intrinsic.json").write_text(
        '{"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 601, 0, 320, 241, 1]}'
    )
    recording = open_folder(tmp_path, None)
    pinhole = recording.calibration.pinhole
    assert (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy) == (600.0, 601.0, 320.0, 241.0)
    assert recording.frames.stamps_s.tolist() == [0.0, 0.033369, 0.066738]
    assert recording.frames.pairs[0].skew_s == 0.005
    (tmp_path / "camera_intrinsic.json").write_text('{"width": 640}')
    assert "DIR/camera_intrinsic.json: is not a camera of Open3D" in complaint(tmp_path)


def test_a_camera_file_replaces_the_layouts_camera(copied: Callable[[str], Path]) -> None:
    folder = copied("ICL-NUIM")
    file = folder / "camera.yaml"
    file.write_text(
        "Camera.fx: 500.0\nCamera.fy: 500.0\nCamera.cx: 320.0\nCamera.cy: 240.0\n"
        "Camera.width: 640\nCamera.height: 480\n"
    )
    camera = open_folder(folder, file).calibration
    assert (camera.fx, camera.depth_factor) == (500.0, 5000.0)


def test_an_image_that_lacks_its_partner_is_counted(copied: Callable[[str], Path]) -> None:
    folder = copied("7-Scenes")
    (folder / "frame-000001.depth.png").unlink()
    recording = open_folder(folder, None)
    assert (len(recording.frames.pairs), recording.frames.unpaired) == (FRAMES - 1, 1)
    assert "images without a partner: 1" in recording.summary
    np.testing.assert_allclose(recording.frames.stamps_s, [0, 2 / 30, 3 / 30], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "missing", "expected"),
    [
        ("ICL-NUIM", "associations.txt", "DIR/associations.txt: no such file; a folder of ICL-"),
        ("ICL-NUIM", "rgb", "DIR/rgb/0.png: names DIR/rgb/0.png, which is missing"),
        ("7-Scenes", "*.depth.png", "DIR: has 4 color images, such as frame-000000.color.png, but"),
        ("Redwood", "depth", "DIR/depth: no numbered images, as in color/"),
        ("ScanNet", "depth", "DIR: has 4 color images, such as 0.jpg, but no depth image of the"),
        ("ScanNet", "intrinsic", "DIR/intrinsic/intrinsic_color.txt: no such file; export"),
    ],
)
def test_a_folder_that_lacks_a_part_says_which(
    copied: Callable[[str], Path], name: str, missing: str, expected: str
) -> None:
    folder = copied(name)
    for path in list(folder.glob(missing)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert complaint(folder).startswith(expected)


@pytest.mark.parametrize(
    ("name", "file", "text", "expected"),
    [
        ("7-Scenes", "frame-000002.pose.txt", "1 2 3\n", "has 3 numbers"),
        ("7-Scenes", "frame-000002.pose.txt", "x " * 16, "could not convert"),
        ("ScanNet", "pose/2.txt", "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1", "not a rotation"),
        ("ScanNet", "pose/2.txt", "", "holds no pose"),
        ("ScanNet", "intrinsic/intrinsic_color.txt", "1 2\n", "has 2 numbers"),
        ("Redwood", "trajectory.log", "0 0 1\n1 2 3 4\n", ":1: below it are not the four rows"),
        ("ICL-NUIM", "livingRoom2.gt.freiburg", "1 0 0 0\n", ":1: 4 columns where 8"),
    ],
)
def test_a_damaged_file_is_named(
    copied: Callable[[str], Path], name: str, file: str, text: str, expected: str
) -> None:
    folder = copied(name)
    (folder / file).write_text(text)
    message = complaint(folder)
    assert message.startswith(f"DIR/{file}")
    assert expected in message


def test_the_folder_above_the_frames_is_no_recording(written: Path) -> None:
    assert complaint(written) == (
        "DIR: is no recording, but has 4 in it; name one, such as DIR/7-Scenes"
    )


def test_a_tum_folder_without_its_lists_is_not_taken_for_redwood(tmp_path: Path) -> None:
    color, depth, _ = make_frame(0)
    save(tmp_path / "rgb/1305031102.175304.png", color)
    save(tmp_path / "depth/1305031102.160407.png", depth)
    assert complaint(tmp_path).startswith("DIR/rgb.txt: no such file")


def test_every_frame_is_delivered_by_the_camera(tmp_path: Path) -> None:
    write_redwood(tmp_path, [make_frame(number) for number in range(FRAMES)])
    with RecordingCamera(tmp_path) as camera:
        assert [frame.seq for frame in camera] == list(range(FRAMES))
