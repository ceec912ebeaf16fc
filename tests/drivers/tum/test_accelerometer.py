"""Gravity in a recording: read as it was written, and from the benchmark's own file."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import AccelerometerReading, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Vector
from drivers.playback.camera import RecordingCamera
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.accelerometer import ACCELEROMETER_FILE, format_reading, read_accelerometer
from drivers.tum.writer import TumFolder
from tests.drivers.conftest import make_frame

FolderMaker = Callable[..., Path]
LEVEL: Vector = (0.0, 9.80665, 0.0)


def record(folder: Path, frames: list[RgbdFrame]) -> Path:
    with FrameRecorder(TumFolder(folder)) as writer:
        for frame in frames:
            writer.write(frame)
    return folder


def gravities(folder: Path) -> list[Vector | None]:
    with RecordingCamera(folder) as camera:
        return [camera.read(10).gravity_m_s2 for _ in range(camera.frame_count or 0)]


def test_a_recording_replays_with_the_same_gravity_bit_for_bit(tmp_path: Path) -> None:
    measured: list[Vector | None] = [(0.1 / 3 + k / 7, 9.7, -1.5 + k / 3) for k in range(4)]
    measured[2] = None
    frames = [make_frame(k, gravity_m_s2=gravity) for k, gravity in enumerate(measured)]
    found = gravities(record(tmp_path / "room", frames))
    assert (found[0], found[1], found[3]) == (measured[0], measured[1], measured[3])


def test_frames_have_the_newest_readings_also_those_of_motion(tmp_path: Path) -> None:
    folder = record(tmp_path / "room", [make_frame(k, stamp_s=1000.0 + k) for k in range(3)])
    lines = [f"{1000 + 0.1 * k:.1f} {k}.0 9.8 0.0\n" for k in range(21)]
    (folder / ACCELEROMETER_FILE).write_text("".join(lines))
    with RecordingCamera(folder) as camera:
        readings = [camera.read(10).accelerometer for _ in range(3)]
    assert [len(each) for each in readings] == [1, 11, 16]
    assert readings[1][-1] == AccelerometerReading(1001.0, (-10.0, -9.8, 0.0))


def test_a_camera_without_gravity_leaves_no_file(tmp_path: Path) -> None:
    folder = record(tmp_path / "room", [make_frame(k) for k in range(3)])
    assert not (folder / ACCELEROMETER_FILE).exists()
    assert gravities(folder) == [None] * 3


def test_readings_of_other_stamps_are_averaged_over_the_previous_second(tmp_path: Path) -> None:
    lines = [
        "# timestamp ax ay az",
        "8.9 0 9.9 3",
        "9.2 0.5 9.8 -1",
        "9.9 0.1 9.6 -2",
        "10.1 0 0 9",
    ]
    (tmp_path / ACCELEROMETER_FILE).write_text("\n".join(lines))
    found = read_accelerometer(tmp_path).gravity_at(10.0)
    assert found == pytest.approx((0.3, 9.7, 1.5))  # looking down: gravity is ahead too


def test_invalid_gravity_is_skipped(tmp_path: Path) -> None:
    (tmp_path / ACCELEROMETER_FILE).write_text("1.0 0 0 0\n1.1 0 9.8 0\n1.2 0 14 0\n")
    assert read_accelerometer(tmp_path).gravity_at(1.3) == (0.0, 9.8, 0.0)
    assert read_accelerometer(tmp_path).gravity_at(5.0) is None


def test_an_empty_list_gives_no_gravity(tmp_path: Path) -> None:
    (tmp_path / ACCELEROMETER_FILE).write_text("# accelerometer data\n")
    assert read_accelerometer(tmp_path).gravity_at(1.0) is None


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("1.0 0 9.8", r"accelerometer\.txt:2: 3 columns where 4 are expected"),
        ("1.0 0 9.8 up", r"accelerometer\.txt:2: '1\.0 0 9\.8 up' is not timestamp ax ay az"),
        ("1.0 0 nan 0", r"accelerometer\.txt:2: a number is not finite"),
    ],
)
def test_a_broken_list_is_reported_with_its_line(tmp_path: Path, line: str, complaint: str) -> None:
    (tmp_path / ACCELEROMETER_FILE).write_text(f"# timestamp ax ay az\n{line}\n")
    with pytest.raises(InputError, match=complaint):
        read_accelerometer(tmp_path)


@given(st.tuples(*[st.floats(-5.0, 5.0)] * 2), st.floats(0.0, 1e10))
def test_every_gravity_survives_the_file(
    tmp_path_factory: pytest.TempPathFactory, across: tuple[float, float], stamp_s: float
) -> None:
    folder = tmp_path_factory.mktemp("track")
    gravity = (across[0], 9.0, across[1])
    (folder / ACCELEROMETER_FILE).write_text(f"{stamp_s!r} {format_reading(gravity)}\n")
    is_kept = abs(sum(v * v for v in gravity) ** 0.5 / 9.80665 - 1) <= 0.1
    assert read_accelerometer(folder).gravity_at(stamp_s) == (gravity if is_kept else None)
