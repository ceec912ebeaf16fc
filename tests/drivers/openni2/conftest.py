"""Recordings for libOpenNI2, written by the tests and played by the library itself."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import RgbdCamera, RgbdFrame
from drivers.playback.camera import RecordingCamera
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.simulators.oni_writer import OniImage, OniSensor, frames_to_oni_images, write_oni

SIZE = (64, 48)
CAMERA_FILE = """schema = 1
width = 64
height = 48
fx = 52.5
fy = 52.5
cx = 31.5
cy = 23.5
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
depth_factor = 1000.0
"""
# The same camera, with a depth camera that is it itself.
DEPTH_CAMERA = """
[depth]
width = 64
height = 48
fx = 52.5
fy = 52.5
cx = 31.5
cy = 23.5

[depth.T_color_depth]
translation_m = [0.0, 0.0, 0.0]
quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]
"""


@pytest.fixture(autouse=True, scope="session")
def needs_openni2(real_openni2: None) -> None:
    """All tests here run on the real libOpenNI2."""


def make_image(sensor: OniSensor, stamp_us: int, seed: int = 0) -> OniImage:
    """A small image of noise."""
    random, (width, height) = np.random.default_rng([seed, stamp_us, sensor]), SIZE
    if sensor is OniSensor.DEPTH:
        depth = random.integers(0, 10000, (height, width), dtype=np.uint16)
        return OniImage(sensor, stamp_us, depth)
    color = random.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return OniImage(sensor, stamp_us, color)


def make_images(frames: int) -> list[OniImage]:
    """Depth and color in turn, 30 a second, depth 2 ms later by its stamp."""
    return [
        make_image(sensor, seq * 33_333 + late_us)
        for seq in range(frames)
        for sensor, late_us in ((OniSensor.DEPTH, 2_000), (OniSensor.COLOR, 0))
    ]


def read_all_frames(camera: RgbdCamera) -> Iterator[RgbdFrame]:
    """Every frame from opening to the end."""
    with camera:
        yield from camera


@pytest.fixture(scope="session")
def camera_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For small recordings; it says that their depth is registered."""
    path = tmp_path_factory.mktemp("openni2") / "camera.toml"
    path.write_text(CAMERA_FILE)
    return path


@pytest.fixture(scope="session")
def depth_camera_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For small recordings; it says that their depth is not registered."""
    path = tmp_path_factory.mktemp("openni2") / "camera.toml"
    path.write_text(CAMERA_FILE + DEPTH_CAMERA)
    return path


@pytest.fixture
def small_oni(tmp_path: Path) -> Path:
    """Eight frames of noise."""
    path = tmp_path / "small.oni"
    write_oni(path, make_images(8))
    return path


@pytest.fixture(scope="session")
def in_millimeters(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the corner as a folder, in whole millimeters and microseconds."""
    folder = tmp_path_factory.mktemp("recordings") / "millimeters"
    with FrameRecorder(TumFolder(folder)) as writer:
        for frame in read_all_frames(RecordingCamera(recording)):
            depth_mm = np.rint(frame.depth_m * 1000).astype(np.uint16)
            stamp_s = round(frame.stamp_s, 6)
            writer.write(replace(frame, stamp_s=stamp_s, depth_raw=depth_mm, depth_factor=1000.0))
    return folder


@pytest.fixture(scope="session")
def corner_oni(in_millimeters: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as an .oni recording."""
    path = tmp_path_factory.mktemp("recordings") / "corner.oni"
    write_oni(path, frames_to_oni_images(read_all_frames(RecordingCamera(in_millimeters))))
    return path
