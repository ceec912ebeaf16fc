"""Conversion between formats loses nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.bag.mcap_recorder import McapRecorder
from drivers.camera import AccelerometerReading, RgbdFrame
from drivers.core import InputError, UserFacingError
from drivers.recording_camera import RecordingCamera, open_recording
from tests.drivers.bag.bag_maker import FRAME, TF, BagWriter, stamp_ns
from tests.drivers.bag.test_bag import make_bag, write_unregistered
from tests.full_disk import limit_file_size
from tests.vo_service.fakes import make_frame
from vo_service.tools.convert import OutputFormat, choose_format, convert

CopyRecording = Callable[..., Path]
OUTPUTS = [("a.mcap", OutputFormat.MCAP), ("a.bag", OutputFormat.ROS1), ("a", OutputFormat.ROS2)]


def ignore_progress(count: int) -> None:
    pass


def convert_path(path: Path, output: Path, kind: OutputFormat | None = None) -> int:
    kind = kind or choose_format(output, None)
    return convert(open_recording(path), output, kind, ignore_progress)


def read_frames(path: Path) -> list[RgbdFrame]:
    with RecordingCamera(path) as camera:
        return list(camera)


def assert_same(ours: list[RgbdFrame], theirs: list[RgbdFrame]) -> None:
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        for name in ("stamp_s", "skew_s", "readout_s", "timing_prior", "depth_factor", "camera"):
            assert getattr(a, name) == getattr(b, name)
        assert a.gravity_m_s2 == b.gravity_m_s2
        np.testing.assert_array_equal(a.color_bgr, b.color_bgr)
        np.testing.assert_array_equal(a.depth_raw, b.depth_raw)


def make_difficult(folder: Path) -> None:
    """Give a recording a distorted lens, timing, another depth unit, gravity and long stamps."""
    text = (folder / "camera.toml").read_text()
    lines = [
        line for line in text.splitlines()
        if not line.startswith(("distortion", "depth_factor", "readout", "depth_offset"))
    ]  # fmt: skip
    extra = ["distortion = [0.1, -0.2, 0.01, 0.0, 0.05]", "depth_factor = 3456.7"]
    extra += ["readout_s = 0.0291", "depth_offset_s = 0.0071", "readout_sigma_s = 0.002"]
    (folder / "camera.toml").write_text("\n".join([*lines, *extra]) + "\n")
    associations = (folder / "associations.txt").read_text().splitlines()
    rows = [line.split() for line in associations if not line.startswith("#")]
    rows = [[f"{a}000123456789", b, f"{c}000987654321", d] for a, b, c, d in rows]
    (folder / "associations.txt").write_text("\n".join(map(" ".join, rows)) + "\n")
    (folder / "accelerometer.txt").write_text(
        "".join(f"{float(row[0])!r} 0.1 9.{k:02} 0.3\n" for k, row in enumerate(rows))
    )


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_a_folder_and_back_is_the_same_recording(
    copy_recording: CopyRecording, tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    folder = copy_recording()
    make_difficult(folder)
    count = convert_path(folder, tmp_path / "new" / name, kind)
    original = read_frames(folder)
    assert count == len(original)
    assert_same(read_frames(tmp_path / "new" / name), original)
    convert_path(tmp_path / "new" / name, tmp_path / "back")
    assert_same(read_frames(tmp_path / "back"), original)


def test_ground_truth_comes_along(copy_recording: CopyRecording, tmp_path: Path) -> None:
    folder = copy_recording()
    for name, kind in OUTPUTS:
        convert_path(folder, tmp_path / name, kind)
        ours, theirs = open_recording(tmp_path / name), open_recording(folder)
        assert ours.ground_truth is not None
        assert theirs.ground_truth is not None
        np.testing.assert_array_equal(ours.ground_truth.stamps_s, theirs.ground_truth.stamps_s)
        np.testing.assert_allclose(
            ours.ground_truth.T_world_camera, theirs.ground_truth.T_world_camera, atol=1e-9
        )


def test_gravity_beside_readings_comes_along(tmp_path: Path) -> None:
    readings = tuple(
        AccelerometerReading(1000.0 + 0.01 * k, (0.1 * k, -9.7, 0.0)) for k in range(3)
    )
    with McapRecorder(tmp_path / "a.mcap") as recorder:
        for k in range(2):
            frame = make_frame(k, 1000.1 + k / 30)
            gravity = (0.1, 9.7, 0.3 + 0.1 * k)
            recorder.write(replace(frame, gravity_m_s2=gravity, accelerometer=readings))
    original = read_frames(tmp_path / "a.mcap")
    assert [frame.gravity_m_s2 for frame in original] == [(0.1, 9.7, 0.3), (0.1, 9.7, 0.4)]
    for name, kind in [*OUTPUTS, ("folder", OutputFormat.FOLDER)]:
        convert_path(tmp_path / "a.mcap", tmp_path / "new" / name, kind)
        assert_same(read_frames(tmp_path / "new" / name), original)
        if kind is not OutputFormat.FOLDER:
            assert read_frames(tmp_path / "new" / name)[0].accelerometer == readings


def test_files_in_millimeters_keep_their_bytes(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder = copy_recording()
    text = (folder / "camera.toml").read_text()
    (folder / "camera.toml").write_text(
        text.replace("depth_factor = 5000.0", "depth_factor = 1000.0")
    )
    convert_path(folder, tmp_path / "a.mcap")
    convert_path(tmp_path / "a.mcap", tmp_path / "back")
    files = [each for kind in ("rgb", "depth") for each in (folder / kind).iterdir()]
    assert len(files) == 24
    for file in files:
        copy = tmp_path / "back" / file.relative_to(folder)
        assert copy.read_bytes() == file.read_bytes()


def test_depth_of_another_camera_is_registered(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_unregistered(bag, k)
        move = bag.maker.transform(stamp_ns(k), FRAME, "depth_optical", (0.1, 0.0, 0.2))
        bag.transforms("/tf_static", stamp_ns(k), TF, move)

    path = make_bag(tmp_path / "a", fill)
    convert_path(path, tmp_path / "folder")
    ours, theirs = read_frames(tmp_path / "folder"), read_frames(path)
    np.testing.assert_array_equal(ours[0].depth_raw, theirs[0].depth_raw)


def test_an_image_that_cannot_be_read_is_left_out_and_logged(
    copy_recording: CopyRecording, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = copy_recording()
    sorted((folder / "rgb").iterdir())[3].unlink()
    assert convert_path(folder, tmp_path / "a.mcap") == 11
    assert "is left out" in caplog.text


def test_nothing_is_left_after_a_failure(copy_recording: CopyRecording, tmp_path: Path) -> None:
    def stop(count: int) -> None:
        if count == 3:
            raise KeyboardInterrupt

    folder = copy_recording()
    for name, kind in [*OUTPUTS, ("folder", OutputFormat.FOLDER)]:
        with pytest.raises(KeyboardInterrupt):
            convert(open_recording(folder), tmp_path / "out" / name, kind, stop)
        assert not (tmp_path / "out" / name).exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(
        UserFacingError, match=r"cannot be written: .*; name a file that you may write"
    ):
        convert_path(folder, tmp_path / "file" / "a.mcap")
    with pytest.raises(InputError, match="file: exists already"):
        convert_path(folder, tmp_path / "file")


def test_a_full_disk_is_one_clear_error_and_leaves_nothing(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder = copy_recording()
    for name, kind in [*OUTPUTS, ("folder", OutputFormat.FOLDER)]:
        # SQLite does not tell a limit of the file size.
        advice = "disk I/O error" if kind is OutputFormat.ROS2 else "free some space"
        with (
            limit_file_size(100_000),
            pytest.raises(UserFacingError, match=f"{name}: cannot be written: .*{advice}"),
        ):
            convert_path(folder, tmp_path / "out" / name, kind)
        assert not (tmp_path / "out" / name).exists()


def test_a_format_is_read_whatever_the_name(copy_recording: CopyRecording, tmp_path: Path) -> None:
    folder = copy_recording()
    for name, kind in (
        ("A.MCAP", None),
        ("A.BAG", None),
        ("folder.bag", OutputFormat.FOLDER),
        ("bag.mcap", OutputFormat.ROS2),
    ):
        path = tmp_path / name
        assert convert_path(folder, path, kind) == len(read_frames(path)) == 12


def test_a_name_that_could_not_be_read_is_refused(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"a.bag: a file in the format mcap must end in .mcap"):
        choose_format(Path("a.bag"), "mcap")
    with pytest.raises(InputError, match=r"a: a file in the format ros1 must end in .bag"):
        choose_format(Path("a"), "ros1")
    folder = copy_recording()
    for name in ("a#b", "a%20b", "a?b"):
        with pytest.raises(InputError, match=r"a ROS 2 bag cannot have %, \? or # in its path"):
            convert_path(folder, tmp_path / name, OutputFormat.ROS2)
        assert list(tmp_path.glob("a*")) == []


def test_stamps_that_ros_cannot_hold_are_refused(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder = copy_recording()
    associations = (folder / "associations.txt").read_text().splitlines()[1:]
    rows = [line.split() for line in associations]
    late = [f"{float(a) + 3e9:f} {b} {float(c) + 3e9:f} {d}\n" for a, b, c, d in rows]
    (folder / "associations.txt").write_text("".join(late))
    with pytest.raises(InputError, match="stamps of ROS are between 1970 and 2038; use a folder"):
        convert_path(folder, tmp_path / "a.mcap")
