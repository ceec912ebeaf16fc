"""The same frames as a folder, through libOpenNI2, through fakenect and on a Kinect's wire."""

import math
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, read_trajectory
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.kinect_simulator import KinectSimulator, LoopMode
from tests.simulators.oni_writer import frames_to_oni_images, write_oni
from tests.simulators.raw_depth import NOMINAL, raw_to_mm
from tests.simulators.usb_frames import ColorBgr, DepthMm, write_usb_frames
from tests.vo_service.cli.cli_runner import KinectVo, count_lines, running_subprocess
from tests.vo_service.corner_sequence import RATE_HZ, corner_frames, make_corner_kinect
from tests.vo_service.service_process import ONLY_POSES_CONFIG
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

COUNT = 8
# Slow enough for any machine, as a live camera's late frames are dropped.
PLAYED_HZ = 3
# Of the 1000 that are looked for, those that agree on each motion.
FEWEST_POINTS = 500


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    """What is to be seen by every way, as every recording can hold it."""
    return list(corner_frames(COUNT))


@pytest.fixture
def replayed(frames: list[RgbdFrame], tmp_path: Path, kinect_vo: KinectVo) -> Path:
    """The trajectory that a replay of the folder writes."""
    folder, trajectory = tmp_path / "folder", tmp_path / "replayed.txt"
    with FrameRecorder(TumFolder(folder)) as writer:
        for frame in frames:
            writer.write(frame)
    kinect_vo("replay", folder, "--no-publish", "--trajectory", trajectory)
    return trajectory


@pytest.fixture
def camera_file(replayed: Path) -> Path:
    """The folder's."""
    return replayed.with_name("folder") / "camera.toml"


def served(source: str, camera_file: Path, *options: str, count: int = COUNT) -> Path:
    """The trajectory that the service writes, once it has so many poses."""
    trajectory = camera_file.parents[1] / "served.txt"
    config = camera_file.parents[1] / "kinect.toml"
    config.write_text(f"schema = 1\n{ONLY_POSES_CONFIG}")
    given = ("--camera-file", camera_file, "--no-publish", "--trajectory", trajectory)
    with running_subprocess(
        "run", "--camera", source, "--config", config, *given, *options
    ) as process:
        wait_until(lambda: count_lines(trajectory) >= count or process.poll() is not None)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    return trajectory


def images(frames: list[RgbdFrame]) -> Iterator[tuple[ColorBgr, DepthMm]]:
    return ((frame.color_bgr, frame.depth_raw) for frame in frames)


@pytest.mark.usefixtures("real_openni2")
def test_an_oni_recording_gives_the_same_bytes_as_a_replay(
    frames: list[RgbdFrame], replayed: Path, camera_file: Path, tmp_path: Path
) -> None:
    write_oni(tmp_path / "frames.oni", frames_to_oni_images(frames))
    trajectory = served(f"openni2:{tmp_path / 'frames.oni'}", camera_file, "--pace", "lockstep")
    assert trajectory.read_bytes() == replayed.read_bytes()


@pytest.mark.usefixtures("fakenect")
def test_a_fakenect_dump_gives_the_same_bytes_as_a_replay(
    frames: list[RgbdFrame], replayed: Path, camera_file: Path, tmp_path: Path
) -> None:
    write_fakenect_dump(tmp_path / "dump", images(frames), RATE_HZ)
    trajectory = served(f"fakenect:{tmp_path / 'dump'}", camera_file, "--pace", "lockstep")
    assert trajectory.read_bytes() == replayed.read_bytes()


def test_a_simulated_kinect_gives_the_poses_of_a_replay_within_its_quantization(
    frames: list[RgbdFrame],
    replayed: Path,
    camera_file: Path,
    tmp_path: Path,
    real_libfreenect: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with make_corner_kinect(tmp_path, write_usb_frames(tmp_path, images(frames))) as kinect:
        kinect.rate, kinect.loop, kinect.waits_for_reader = PLAYED_HZ, LoopMode.ONCE, True
        for name, value in kinect.environment.items():
            monkeypatch.setenv(name, value)
        found = read_trajectory(served("freenect", camera_file, count=COUNT - 2))
        seqs = frame_numbers(found.stamps_s, kinect)
    assert seqs[0] >= 0
    assert len(seqs) >= COUNT - 2
    reference = read_trajectory(replayed).T_world_camera[seqs]
    expected = inverse(reference[0]) @ reference
    apart_m = np.linalg.norm((expected - found.T_world_camera)[:, :3, 3], axis=1)
    farthest_mm = int(max(frame.depth_raw.max() for frame in frames))
    assert apart_m.max() <= encoding_costs_m(farthest_mm, motions=seqs[-1] - seqs[0])


def frame_numbers(stamps_s: Array, kinect: KinectSimulator) -> list[int]:
    """Which frames of the sequence these are, by the instant at which the Kinect sent them.

    Stamps are late by what held up the image that came soonest so far. So the last one is nearest
    to the truth, and a step between two is never longer than it should be, but may be half of it.
    """
    unix_s = time.time() - time.monotonic()
    began_s = kinect._control.playback_start_ns / 1e9 + unix_s
    seqs = [round((stamps_s[-1] - began_s) * PLAYED_HZ)]
    for step_s in reversed(np.diff(stamps_s)):
        seqs.insert(0, seqs[0] - math.ceil(step_s * PLAYED_HZ - 0.05))
    return seqs


def encoding_costs_m(farthest_mm: int, motions: int) -> float:
    """How far a position may be off, three sigma, after so many motions from image to image.

    A reading is rounded to the Kinect's steps of depth: off by step / sqrt(12). A motion is the
    mean over the points of two images. Gray is not changed by the mosaic of colors.
    """
    table_mm = raw_to_mm(np.arange(2048, dtype=np.uint16), NOMINAL)
    table_mm = table_mm[table_mm > 0]
    index = int(np.searchsorted(table_mm, farthest_mm))
    step_m = 1e-3 * (int(table_mm[index]) - int(table_mm[index - 1]))
    return 3 * step_m / math.sqrt(12) * math.sqrt(2 * motions / FEWEST_POINTS)
