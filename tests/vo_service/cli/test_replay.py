"""``replay`` over a small recording: figures, trajectory, the same bytes every time, Ctrl-C."""

import json
import signal
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pytest

from drivers.bag.bag_writer import Ros1Writer
from drivers.bag.frame_writer import FrameWriter
from drivers.clock_jumps import MAX_STALE_FRAMES
from drivers.core.geometry import read_trajectory
from drivers.playback.recording_formats import open_recording
from drivers.recording.frame_encoding import FrameStamps
from drivers.recording.recording_sink import StoredFrame
from tests.conftest import FRAMES
from tests.vo_service.cli.cli_runner import (
    CommandResult,
    KinectVo,
    assert_one_line,
    count_lines,
    documented_json_keys,
    run_subprocess,
    running_subprocess,
    stretch_timing,
)
from tests.waiting import wait_until
from vo_service.outputs.zenoh import free_port

FIGURES = (
    *("frames", "failed", "skipped", "coverage", "stage_ms", "cpu_ms_per_frame", "ate_rmse_m"),
    *("mean_global_error_m", "rpe_frame_m", "rpe_frame_deg", "rpe_1s_m", "rpe_1s_deg"),
)
CopyRecording = Callable[..., Path]


@pytest.mark.subprocess
def test_only_one_json_object_is_printed(recording: Path, tmp_path: Path) -> None:
    outcome = run_subprocess("replay", recording, "--no-publish", "--json")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert outcome.out.count("\n") == 1
    figures = json.loads(outcome.out)
    assert set(FIGURES) <= set(figures) <= documented_json_keys()
    assert [figures[key] for key in ("frames", "failed", "skipped", "coverage")] == [
        FRAMES,
        0,
        0,
        1,
    ]
    assert 0 < figures["ate_rmse_m"] < 0.003
    assert 0 < figures["rpe_frame_deg"] < 0.1
    assert figures["rpe_1s_m"] is None  # the recording is shorter
    assert set(figures["stage_ms"]) >= {"images", "align", "covariance"}
    assert figures["cpu_ms_per_frame"] > 0


def test_a_run_without_a_pose_fails_and_names_the_reason(
    blind_recording: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("replay", blind_recording, "--no-publish", "--json")
    assert outcome.code == 1
    assert json.loads(outcome.out)["failed"] >= FRAMES - 1
    reason = f"none of {FRAMES} frames could be tracked; the most frequent reason"
    start = f"{blind_recording}: {reason} ({FRAMES} of {FRAMES})"
    assert f"{start}: cannot start" in outcome.error_lines


def test_the_terminal_shows_a_table(recording: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("replay", recording, "--no-publish")
    assert (outcome.code, outcome.error_lines) == (0, "")
    for label in ("frames", "failed", "CPU a frame", "ATE, RMSE", "RPE, one second", "coverage"):
        assert f"\n{label}  " in f"\n{outcome.out}"


def test_the_trajectory_starts_at_identity_and_follows_the_truth(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    written = tmp_path / "poses.txt"
    kinect_vo("replay", recording, "--no-publish", "--trajectory", written)
    found, truth = read_trajectory(written), read_trajectory(recording / "groundtruth.txt")
    np.testing.assert_array_equal(found.T_world_camera[0], np.eye(4))
    np.testing.assert_array_equal(found.stamps_s, truth.stamps_s)
    np.testing.assert_allclose(found.T_world_camera, truth.T_world_camera, atol=0.004)


def test_an_mcap_file_of_a_replay_can_be_replayed_with_its_ground_truth(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    file = tmp_path / "room.mcap"
    kinect_vo("replay", recording, "--no-publish", "--mcap", file)
    outcome = kinect_vo("replay", file, "--no-publish", "--json")
    figures = json.loads(outcome.out)
    assert (figures["frames"], figures["failed"], figures["coverage"]) == (FRAMES, 0, 1.0)
    assert "ground truth /ground_truth" in outcome.err


def test_a_clock_that_was_set_back_loses_half_a_second_and_the_trajectory_is_sorted(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    bag, written = tmp_path / "jump.bag", tmp_path / "poses.txt"
    count, before = 40, 20
    write_jump_bag(recording, bag, count, before)
    outcome = kinect_vo("replay", bag, "--no-publish", "--json", "--trajectory", written)
    assert outcome.err.count("the clock jumps back by 100.0 s after 1000.627") == 1
    figures = json.loads(outcome.out)
    used = count - MAX_STALE_FRAMES + 1
    assert [figures[key] for key in ("frames", "failed", "skipped")] == [used, 0, count - used]
    stamps_s = read_trajectory(written).stamps_s
    assert (len(stamps_s), int((stamps_s > 999).sum())) == (used, before)


def write_jump_bag(recording: Path, path: Path, count: int, before: int) -> None:
    """Write the recording there and back; the clock is set back by 100 s after some frames."""
    opened = open_recording(recording)
    there_and_back = [*range(FRAMES), *range(FRAMES - 2, 0, -1)]
    bag = Ros1Writer(path)
    writer = FrameWriter(bag, opened.calibration, Decimal(1000))
    for k, index in enumerate(islice(cycle(there_and_back), count)):
        pair, logged = opened.frames.pairs[index], 1000 + k * Decimal("0.033")
        stamp = logged if k < before else logged - 100
        images = pair.color.read_stored_color(), pair.depth.read_stored_depth()
        stamps, log_times = FrameStamps(stamp, stamp), FrameStamps(logged, logged)
        writer.write_frame(StoredFrame(stamps, *images, log_times))
    bag.close()


def test_an_unreadable_frame_in_the_middle_is_skipped_counted_and_reported(
    copy_recording: CopyRecording, kinect_vo: KinectVo
) -> None:
    folder = copy_recording()
    broken = folder / "rgb" / "0.200000.png"
    broken.write_bytes(broken.read_bytes()[:500])
    outcome = kinect_vo("replay", folder, "--no-publish", "--json")
    figures = json.loads(outcome.out)
    assert (outcome.code, outcome.err.count("\n")) == (0, 1)
    assert outcome.err.startswith(f"kinect-vo: warning: frame 6 is skipped: {broken}: is truncated")
    assert [figures[key] for key in ("frames", "failed", "skipped")] == [FRAMES - 1, 0, 1]
    assert figures["coverage"] == pytest.approx((FRAMES - 1) / FRAMES)


def test_a_camera_file_on_the_command_line_takes_precedence(
    copy_recording: CopyRecording, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = copy_recording()
    given = (folder / "camera.toml").rename(tmp_path / "given.toml")
    assert kinect_vo("replay", folder, "--no-publish").code == 2
    assert kinect_vo("replay", folder, "--no-publish", "--camera-file", given).code == 0


@pytest.mark.subprocess
def test_ctrl_c_ends_it_and_keeps_complete_lines(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder, written = stretch_timing(copy_recording(lists=True), 0.5), tmp_path / "poses.txt"
    options = ("--no-publish", "--json", "--pace", "realtime", "--trajectory", written)
    with running_subprocess("replay", folder, *options) as process:
        wait_until(lambda: count_lines(written) >= 2)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=100)
    result = CommandResult(process.returncode, out, err)
    # A busy machine adds lines that tell how long a step took.
    assert (result.code, result.error_lines.count("\n")) == (130, err.count("no evaluation"))
    poses = count_lines(written)
    assert 2 <= poses < FRAMES
    assert written.read_bytes().endswith(b"\n")
    assert json.loads(out)["frames"] == poses == len(read_trajectory(written))


def test_a_bag_is_not_overwritten_by_its_own_outputs(
    copy_recording: CopyRecording, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    file = tmp_path / "room.mcap"
    kinect_vo("convert", copy_recording(), file)
    before = file.read_bytes()
    for option in ("--trajectory", "--optimized-trajectory", "--mcap"):
        outcome = kinect_vo("replay", file, "--pace", "realtime", option, file)
        message = f"kinect-vo: error: {file}: belongs to the recording; name another file\n"
        assert (outcome.code, outcome.error_lines) == (2, message)
    assert file.read_bytes() == before


def test_a_subscriber_is_not_waited_for_if_nothing_is_published(
    copy_recording: CopyRecording, kinect_vo: KinectVo
) -> None:
    options = ("--no-publish", "--wait-for-subscriber", "10")
    outcome = kinect_vo("replay", copy_recording(), *options)
    assert_one_line(outcome, 2, "--wait-for-subscriber: nobody can subscribe with --no-publish")


@pytest.mark.parametrize("one", ["--trajectory", "--rerun"])
@pytest.mark.parametrize("other", ["--mcap", "--optimized-trajectory"])
def test_two_outputs_to_one_file_are_refused(
    copy_recording: CopyRecording, tmp_path: Path, kinect_vo: KinectVo, one: str, other: str
) -> None:
    file = tmp_path / "out.rrd"
    outcome = kinect_vo("replay", copy_recording(), one, file, other, file)
    message = f"kinect-vo: error: {file}: two outputs would be written to it; name another file\n"
    assert (outcome.code, outcome.error_lines) == (2, message)
    assert not file.exists()


def test_a_recording_is_not_overwritten_by_its_own_trajectory(
    copy_recording: Callable[..., Path], kinect_vo: KinectVo
) -> None:
    folder = copy_recording()
    before = (folder / "groundtruth.txt").read_bytes()
    outcome = kinect_vo("replay", folder, "--trajectory", folder / "groundtruth.txt")
    assert_one_line(outcome, 2, "groundtruth.txt: belongs to the recording; name another file")
    assert (folder / "groundtruth.txt").read_bytes() == before


@pytest.mark.subprocess
def test_replays_at_once_in_other_processes_give_the_same_bits(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    files = [tmp_path / f"{number}.txt" for number in range(4)]
    kinect_vo("replay", recording, "--no-publish", "--trajectory", files[0])
    with ThreadPoolExecutor(3) as pool:
        outcomes = list(
            pool.map(
                lambda file: run_subprocess("replay", recording, "--trajectory", file), files[1:]
            )
        )
    assert [outcome.code for outcome in outcomes] == [0] * 3, outcomes
    assert len({file.read_bytes() for file in files}) == 1
    assert count_lines(files[0]) == FRAMES


@pytest.mark.zenoh
def test_a_default_port_in_use_is_one_log_line_and_no_error(
    recording: Path, config: Path, port: int, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(free_port, "DEFAULT_ENDPOINT", f"tcp/127.0.0.1:{port}")
    with socket.create_server(("127.0.0.1", port)):
        outcome = kinect_vo("replay", recording, "--config", config, "--json")
    assert (outcome.code, json.loads(outcome.out)["frames"]) == (0, FRAMES)
    # A busy machine also tells what it waits for.
    (line,) = [line for line in outcome.err.splitlines() if " poses: " in line]
    assert line.startswith("kinect-vo: info: poses: kinect/odom at tcp/127.0.0.1:")
    assert f"as tcp/127.0.0.1:{port} is in use (kinect-vo listen --connect tcp/" in line
    assert "error" not in outcome.err
