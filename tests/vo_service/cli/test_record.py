"""``record``: what was recorded replays as the source did."""

import json
import time
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from drivers.camera import CameraState, CameraStatus, Clock, FrameTimeout
from tests.conftest import FRAMES
from tests.drivers.bag.test_bag import make_bag, write_two_cameras
from tests.vo_service.cli.cli_runner import KinectVo
from tests.vo_service.fakes import Delay, Event, FakeClock, ScriptedCamera, make_frame
from vo_service.cli import record

MISSING = CameraStatus(CameraState.ABSENT, "no Kinect found; plug one in")


@pytest.mark.parametrize(("name", "options"), [("copy", []), ("copy.mcap", ["--raw"])])
def test_a_copied_recording_replays_to_the_same_bytes(
    name: str, options: list[str], recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    copy = tmp_path / name
    outcome = kinect_vo("record", "--camera", f"tum:{recording}", *options, copy)
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert outcome.out == f"{FRAMES} frames in {copy}\n"
    for source, written in ((recording, tmp_path / "a.txt"), (copy, tmp_path / "b.txt")):
        kinect_vo("replay", source, "--no-publish", "--trajectory", written)
    assert (tmp_path / "a.txt").read_bytes() == (tmp_path / "b.txt").read_bytes()
    if copy.is_dir():
        truth = (copy / "groundtruth.txt").read_bytes()
        assert truth == (recording / "groundtruth.txt").read_bytes()


def test_an_mcap_file_has_the_configured_place_of_the_camera(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    config, output = tmp_path / "config.toml", tmp_path / "a.mcap"
    config.write_text("schema = 1\n[T_base_camera]\ntranslation_m = [0.1, 0.2, 0.3]\n")
    kinect_vo("record", "--config", config, "--camera", f"tum:{recording}", output)
    with AnyReader([output]) as reader:
        (static,) = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/tf_static"
        ]
    place = static.transforms[0].transform.translation  # type: ignore[attr-defined]
    assert (place.x, place.y, place.z) == pytest.approx((0.1, 0.2, 0.3))


@pytest.mark.parametrize(("seconds", "frames"), [("0.2", 6), ("0.001", 1)])
def test_recording_stops_after_the_seconds_of_camera_time(
    seconds: str, frames: int, recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = tmp_path / "short"
    outcome = kinect_vo("record", "--camera", f"tum:{recording}", "--seconds", seconds, folder)
    assert outcome.out == f"{frames} frames in {folder}\n"
    assert len((folder / "associations.txt").read_text().splitlines()) == 1 + frames


def test_a_recording_in_jpeg_can_be_replayed(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = tmp_path / "small"
    kinect_vo("record", "--camera", f"tum:{recording}", "--jpeg", folder)
    assert len(list((folder / "rgb").glob("*.jpg"))) == FRAMES
    outcome = kinect_vo("replay", folder, "--no-publish", "--json")
    assert json.loads(outcome.out)["failed"] == 0


def test_the_topics_of_a_bag_are_chosen_and_named(tmp_path: Path, kinect_vo: KinectVo) -> None:
    bag, folder = make_bag(tmp_path / "bag", write_two_cameras), tmp_path / "rear"
    command = ["record", "--camera", f"bag:{bag}", folder]
    assert "equally good; name two of these with --topics" in kinect_vo(*command).err
    topics = ["/rear/color/image_raw", "/rear/depth/image_raw"]
    outcome = kinect_vo(*command, "--topics", *topics)
    assert outcome.out == f"4 frames in {folder}\n"
    assert f"{bag}: color {topics[0]}, depth {topics[1]}" in outcome.err
    other = kinect_vo("run", "--camera", f"tum:{folder}", "--topics", *topics)
    assert (
        other.error_lines
        == f"kinect-vo: error: camera 'tum:{folder}' has no topics; leave out --topics\n"
    )


def have_camera(monkeypatch: pytest.MonkeyPatch, *events: Event) -> None:
    """The camera that is recorded, whatever is asked for; it is waited for in no time."""
    clock = FakeClock()
    monkeypatch.setattr(record, "time", clock)
    camera = ScriptedCamera(events, clock=clock)
    monkeypatch.setattr(record, "open_camera", lambda *_, **__: camera)


def test_a_missing_camera_is_an_error_after_a_timeout_without_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    have_camera(monkeypatch, MISSING, Delay(9.0, FrameTimeout()), Delay(2.0, FrameTimeout()))
    outcome = kinect_vo("record", tmp_path / "new")
    assert outcome.err == (
        "kinect-vo: error: scripted: no frame for 10 s, the camera is absent: no Kinect found; "
        "plug one in; check the camera and record again\n"
    )
    assert (outcome.code, outcome.out) == (1, "")
    assert not (tmp_path / "new").exists()


def test_a_camera_that_prepares_its_frames_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    preparing = CameraStatus(CameraState.STARTING, "preparing its room")
    pauses = [Delay(50.0, FrameTimeout()), Delay(50.0, FrameTimeout())]
    have_camera(monkeypatch, preparing, *pauses, make_frame(1))
    outcome = kinect_vo("record", tmp_path / "new")
    assert (outcome.code, outcome.out) == (0, f"1 frames in {tmp_path / 'new'}\n")


def test_a_stop_before_the_first_frame_creates_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    have_camera(monkeypatch)
    outcome = kinect_vo("record", tmp_path / "new")
    assert (outcome.code, outcome.out) == (0, "no frame received: nothing is written\n")
    assert not (tmp_path / "new").exists()


def test_a_late_or_reconnected_camera_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    pause = Delay(9.0, FrameTimeout())
    have_camera(monkeypatch, MISSING, pause, make_frame(1), MISSING, pause, make_frame(2))
    outcome = kinect_vo("record", tmp_path / "new")
    assert (outcome.code, outcome.out) == (0, f"2 frames in {tmp_path / 'new'}\n")


def test_a_recording_of_a_disconnected_camera_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    frames, pause = [make_frame(k) for k in (1, 2, 3)], Delay(11.0, FrameTimeout())
    have_camera(monkeypatch, *frames[:2], MISSING, pause, frames[2])
    outcome = kinect_vo("record", tmp_path / "new")
    assert outcome.code == 1
    assert "plug one in; the frames recorded so far are complete\n" in outcome.err
    assert len((tmp_path / "new" / "associations.txt").read_text().splitlines()) == 1 + 2


def test_a_live_camera_is_recorded_in_unix_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    camera = ScriptedCamera([make_frame(k, time.monotonic() + k) for k in range(3)])
    camera.clock = Clock.MONOTONIC
    monkeypatch.setattr(record, "open_camera", lambda *_, **__: camera)
    before_s = time.time()
    kinect_vo("record", tmp_path / "new")
    lines = (tmp_path / "new" / "rgb.txt").read_text().splitlines()
    stamps = [float(line.split()[0]) for line in lines[1:]]
    assert before_s - 5.0 < stamps[0] < time.time() + 5.0
    assert [stamp - stamps[0] for stamp in stamps] == pytest.approx([0.0, 1.0, 2.0], abs=0.1)
