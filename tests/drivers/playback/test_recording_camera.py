import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.calibration import format_calibration, read_calibration
from drivers.camera import CameraCounters, CameraState, CameraStatus, Clock, PlaybackMode
from drivers.core import CameraError, InputError
from drivers.playback.camera import RecordingCamera
from drivers.playback.frame_reader import FrameReader

FolderMaker = Callable[..., Path]


def image(folder: Path, kind: str, number: int) -> Path:
    return sorted((folder / kind).iterdir())[number]


def test_lockstep_gives_every_frame_as_it_is_on_disk(make_folder: FolderMaker) -> None:
    folder = make_folder(count=12)
    with RecordingCamera(folder) as camera:
        read = list(camera)
        assert camera.frame_count == 12
        assert camera.counters == CameraCounters(delivered=12)
    assert [frame.seq for frame in read] == list(range(12))
    assert read[0].stamp_s == 1305031102.175304
    assert read[3].skew_s == 0.005
    assert read[0].camera == read_calibration(folder / "camera.toml").pinhole
    for k, frame in enumerate(read):
        np.testing.assert_array_equal(frame.color_bgr, cv2.imread(str(image(folder, "rgb", k))))
        np.testing.assert_array_equal(
            frame.depth_raw, cv2.imread(str(image(folder, "depth", k)), -1)
        )


def test_it_describes_itself(make_folder: FolderMaker) -> None:
    folder = make_folder()
    camera = RecordingCamera(folder)
    assert camera.name == f"tum:{folder}"
    assert camera.clock is Clock.RECORDED
    assert (camera.frame_count, camera.ground_truth) == (None, None)
    with camera:
        assert camera.frame_count == 5


def test_it_is_starting_until_its_first_frame_is_read(make_folder: FolderMaker) -> None:
    camera = RecordingCamera(make_folder())
    assert camera.status == CameraStatus(CameraState.OPENING)
    with camera:
        assert camera.status == CameraStatus(CameraState.STARTING)
        camera.read(10.0)
        assert camera.status == CameraStatus(CameraState.STREAMING)
    assert camera.status == CameraStatus(CameraState.STREAMING)


def test_the_camera_file_gives_the_sensor_timing(make_folder: FolderMaker) -> None:
    folder = make_folder(count=3, skew_s=0.005)
    late = replace(read_calibration(folder / "camera.toml"), depth_offset_s=-0.012)
    (folder / "camera.toml").write_text(format_calibration(late))
    with RecordingCamera(folder) as camera:
        read = list(camera)
    assert {frame.readout_s for frame in read} == {0.02}
    assert [frame.skew_s for frame in read] == pytest.approx([0.005 - 0.012] * 3)


def test_frames_are_undistorted(make_folder: FolderMaker, tmp_path: Path) -> None:
    folder = make_folder()
    straight, bent = (folder / "camera.toml").read_text(), tmp_path / "bent.toml"
    bent.write_text(straight.replace("[0.0, 0.0,", "[0.3, 0.0,"))
    with RecordingCamera(folder) as plain, RecordingCamera(folder, bent) as corrected:
        a, b = plain.read(10), corrected.read(10)
    assert a.camera == b.camera
    assert not np.array_equal(a.color_bgr, b.color_bgr)
    assert set(np.unique(b.depth_raw)) <= {0, *np.unique(a.depth_raw)}


@pytest.mark.parametrize("damage", ["cut", "gone", "text", "8 bits", "small"])
def test_one_bad_frame_is_skipped_counted_and_reported_once(
    make_folder: FolderMaker, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    folder = make_folder()
    bad = image(folder, "depth", 2)
    whole = bad.read_bytes()
    bad.unlink()
    if damage == "cut":
        bad.write_bytes(whole[: len(whole) // 2])
    elif damage == "text":
        bad.write_text("hello")
    elif damage in ("8 bits", "small"):
        shape, dtype = ((48, 64), np.uint8) if damage == "8 bits" else ((24, 32), np.uint16)
        cv2.imwrite(str(bad), np.zeros(shape, dtype))
    with caplog.at_level(logging.WARNING), RecordingCamera(folder) as camera:
        assert [frame.seq for frame in camera] == [0, 1, 3, 4]
        assert camera.counters == CameraCounters(delivered=4, skipped=1)
    assert len(caplog.records) == 1
    assert str(bad) in caplog.text


def test_registered_depth_of_half_the_size_is_enlarged(make_folder: FolderMaker) -> None:
    folder = make_folder()
    small = np.arange(1000, 1000 + 24 * 32, dtype=np.uint16).reshape(24, 32)
    for number in range(5):
        cv2.imwrite(str(image(folder, "depth", number)), small)
    with RecordingCamera(folder) as camera:
        depth = camera.read(10).depth_raw
        note = camera.recording.summary
    np.testing.assert_array_equal(depth, small.repeat(2, axis=0).repeat(2, axis=1))
    assert note == f"{folder}: depth of 32x24 is enlarged to 64x48"


@pytest.mark.parametrize(("period_s", "unit"), [(33.3, "1000"), (33333.0, "1000000")])
def test_stamps_in_a_smaller_unit_than_seconds_get_a_warning(
    make_folder: FolderMaker, caplog: pytest.LogCaptureFixture, period_s: float, unit: str
) -> None:
    folder = make_folder(period_s=period_s)
    with RecordingCamera(folder):
        pass
    assert f"{folder}: the frames are {period_s:.0f} s apart" in caplog.text
    assert caplog.text.rstrip().endswith(f"divide them by {unit}")


def test_realtime_accounts_for_every_frame_of_a_slow_reader(make_folder: FolderMaker) -> None:
    folder = make_folder(count=40, period_s=0.01)
    image(folder, "rgb", 39).write_bytes(b"")
    with RecordingCamera(folder, playback_mode=PlaybackMode.REALTIME) as camera:
        seqs = []
        for frame in camera:
            seqs.append(frame.seq)
            time.sleep(0.06)  # a slow reader; the camera notices only at its next read
        totals = camera.counters
    assert seqs == sorted(set(seqs))
    assert totals.delivered == len(seqs) < 20
    assert totals.delivered + totals.dropped + totals.skipped == 40


@pytest.mark.parametrize("pace", PlaybackMode)
def test_closing_in_the_middle_ends_the_thread(
    make_folder: FolderMaker, pace: PlaybackMode
) -> None:
    camera = RecordingCamera(make_folder(count=20), playback_mode=pace)
    for _ in range(5):
        camera.open()
        camera.close()
    camera.open()
    camera.read(10)
    camera.close()
    camera.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "recording-decode"]
    assert camera.counters.delivered == 1
    with pytest.raises(CameraError, match="not open"):
        camera.read(1)


def test_it_can_be_opened_again_from_the_start(make_folder: FolderMaker) -> None:
    camera = RecordingCamera(make_folder(count=6))
    for _ in range(2):
        with camera:
            assert [frame.seq for frame in camera] == [0, 1, 2, 3, 4, 5]
    assert camera.counters.delivered == 12


def test_a_failed_open_leaves_nothing_behind(tmp_path: Path) -> None:
    camera = RecordingCamera(tmp_path / "gone")
    with pytest.raises(InputError, match="no such folder"):
        camera.open()
    camera.close()
    assert camera.frame_count is None


def test_an_error_in_the_thread_reaches_the_reader(
    make_folder: FolderMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **_named: object) -> None:
        raise MemoryError("no room for an image")

    monkeypatch.setattr(FrameReader, "read", broken)
    with RecordingCamera(make_folder()) as camera, pytest.raises(MemoryError, match="no room"):
        camera.read(10)


def test_nothing_is_printed_for_broken_images(
    make_folder: FolderMaker, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = make_folder(count=4, kind="jpg")
    for kind in ("rgb", "depth"):
        file = image(folder, kind, 1 if kind == "rgb" else 2)
        file.write_bytes(file.read_bytes()[:-30])
    with RecordingCamera(folder) as camera:
        assert [frame.seq for frame in camera] == [0, 3]
    assert capfd.readouterr() == ("", "")


def test_redkitchen_is_500_frames(recordings: Path) -> None:
    with RecordingCamera(recordings / "redkitchen") as camera:
        assert camera.frame_count == 500
        assert sum(1 for _ in islice(camera, 10)) == 10
        assert camera.ground_truth is not None
        assert camera.counters == CameraCounters(delivered=10)


@pytest.mark.parametrize(
    ("name", "count"), [("freiburg1_xyz_head", 10), ("freiburg1_desk_piece", 9)]
)
def test_freiburg1_pieces_are_undistorted(recordings: Path, name: str, count: int) -> None:
    folder = recordings / name
    with RecordingCamera(folder) as camera:
        read = list(camera)
        assert camera.ground_truth is not None
    assert len(read) == count
    seen = cv2.imread(str(image(folder, "rgb", 0)))
    first_depth = cv2.imread(str(image(folder, "depth", 0)), -1)
    assert seen is not None
    assert first_depth is not None
    calibration = read_calibration(folder / "camera.toml")
    ours = read[0].color_bgr.astype(int)
    theirs = cv2.undistort(seen, calibration.pinhole.K, np.array(calibration.distortion))
    # Both round coordinates to 1/32 px, not alike: a few levels where the image is steep.
    assert np.abs(ours - theirs).max() <= 8
    assert np.abs(ours - theirs).mean() < 0.05
    assert np.abs(ours - seen).max() > 50
    assert set(np.unique(read[0].depth_raw)) <= {0, *np.unique(first_depth)}
