"""Recordings that cannot be played: one line says what is wrong and what to do."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.openni2.oni_camera import OniCamera
from drivers.openni2.oni_index import read_oni_index
from tests.drivers.openni2.conftest import make_image, make_images
from tests.simulators.oni_writer import OniSensor, OniSettings, write_oni


def complaint(path: Path, camera_file: Path | None = None) -> str:
    with pytest.raises(InputError) as error:
        OniCamera(path, camera_file).open()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_missing_file_or_folder(tmp_path: Path, small_oni: Path) -> None:
    missing, folder = tmp_path / "none.oni", tmp_path
    cause = "No such file or directory; give an .oni file"
    assert complaint(missing) == f"{missing}: cannot be read: {cause}"
    cause = "it is a folder, not a file; give an .oni file"
    assert complaint(folder) == f"{folder}: cannot be read: {cause}"
    assert "none.toml" in complaint(small_oni, tmp_path / "none.toml")


@pytest.mark.parametrize("content", [b"", b"junk", b"\0" * 100, b"NI10", b"%PDF-1.7" * 20])
def test_not_a_recording(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "junk.oni"
    path.write_bytes(content)
    assert complaint(path) == f"{path}: is not an OpenNI recording (.oni)"


def test_other_version_of_the_format(small_oni: Path) -> None:
    content = bytearray(small_oni.read_bytes())
    content[6] = 0
    small_oni.write_bytes(content)
    assert "its format has version 1.0.0.0, only 1.0.1.0 is supported" in complaint(small_oni)


def test_recording_of_a_killed_recorder(tmp_path: Path) -> None:
    path = tmp_path / "killed.oni"
    write_oni(path, make_images(3), OniSettings(finished=False))
    assert "is unfinished" in complaint(path)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999))
def test_truncated_anywhere(share: float, small_oni: Path, tmp_path: Path) -> None:
    content = small_oni.read_bytes()
    path = tmp_path / "short.oni"
    path.write_bytes(content[: int(share * len(content))])
    assert str(path) in complaint(path)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 1500), value=st.integers(0, 255))
def test_a_flipped_byte_is_read_or_refused(
    at: int, value: int, small_oni: Path, tmp_path: Path
) -> None:
    content = bytearray(small_oni.read_bytes())
    content[at] = value
    path = tmp_path / "flipped.oni"
    path.write_bytes(content)
    with suppress(InputError):
        index = read_oni_index(path)
        assert len(index.images) >= 2 * len(index.pairs) > 0


@pytest.mark.parametrize(
    ("only", "lacks"), [(OniSensor.DEPTH, "color"), (OniSensor.COLOR, "depth")]
)
def test_only_one_stream(only: OniSensor, lacks: str, tmp_path: Path) -> None:
    path = tmp_path / "half.oni"
    write_oni(path, [make_image(only, seq * 33_333) for seq in range(3)])
    assert f"holds no {lacks} images; record color and depth together" in complaint(path)


def test_streams_that_never_overlap(tmp_path: Path) -> None:
    path = tmp_path / "apart.oni"
    write_oni(path, [make_image(OniSensor.DEPTH, 0), make_image(OniSensor.COLOR, 500_000)])
    assert "no color image within 20 ms of a depth image" in complaint(path)


def test_no_camera_file(small_oni: Path) -> None:
    text = complaint(small_oni)
    assert "does not store whether its depth was registered to color" in text
    assert "without a [depth] table if it was, with one if it was not" in text


def test_recording_that_the_player_would_discard(tmp_path: Path, camera_file: Path) -> None:
    path = tmp_path / "dropped.oni"
    write_oni(path, make_images(2), OniSettings(cropping=False))
    assert "lacks the cropping property" in complaint(path, camera_file)
