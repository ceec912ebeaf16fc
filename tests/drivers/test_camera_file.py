from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera_file import (
    KNOWN_CAMERAS,
    CameraFile,
    camera_file_text,
    camera_of_folder,
    read_camera_file,
)
from drivers.errors import InputError
from drivers.strict_toml import parse_toml

TEXT = camera_file_text(KNOWN_CAMERAS["1"])
MILLIMETRES = TEXT.replace("depth_factor = 5000.0", "depth_factor = 1000.0")


def complaint(tmp_path: Path, old: str, new: str) -> str:
    assert old in TEXT
    file = tmp_path / "camera.toml"
    file.write_text(TEXT.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_camera_file(file)
    return str(caught.value).removeprefix(str(tmp_path))


@given(
    st.builds(
        CameraFile,
        st.integers(1, 16384),
        st.integers(1, 16384),
        *[st.floats(1.0, 1e6)] * 2,
        *[st.floats(-1e5, 1e5)] * 2,
        st.tuples(*[st.floats(-1e3, 1e3)] * 5),
        st.floats(1.0, 1e6),
        st.floats(0.0, 1.0),
    )
)
def test_what_is_written_reads_back_exactly(camera: CameraFile) -> None:
    read = parse_toml(camera_file_text(camera), "camera.toml", CameraFile)
    assert [repr(getattr(read, f.name)) for f in fields(read)] == [
        repr(getattr(camera, f.name)) for f in fields(camera)
    ]


def test_whole_numbers_and_comments_are_read(tmp_path: Path) -> None:
    text = TEXT.replace("fx = 517.3", "fx = 520  # pixels").replace("readout_s = 0.0", "")
    (tmp_path / "camera.toml").write_text(text.split("  # rolling")[0])
    assert read_camera_file(tmp_path / "camera.toml").fx == 520.0


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("depth_fac", "dept_fac", "/camera.toml:9: key `dept_factor`: is unknown; did you mean `d"),
        ("fx = 517.3", 'fx = "517"', '/camera.toml:4: key `fx`: "517" is the wrong type; give a n'),
        ("depth_factor = 5000.0", "depth_factor = 0", "/camera.toml:9: key `depth_factor`: 0 is o"),
        ("depth_factor = 5000.0", "depth_factor = 2e-4", "/camera.toml:9: key `depth_factor`: 0.0"),
        ("width = 640", "width = 0", "/camera.toml:2: key `width`: 0 is out of range"),
        ("schema = 1", "schema = 2", "/camera.toml:1: key `schema`: version 2 cannot be read"),
        ("1.1633]", "]", "/camera.toml:8: key `distortion`: a list of 4 is the wrong type"),
        ("depth_factor = 5000.0", "", "/camera.toml: key `depth_factor`: is missing"),
    ],
)
def test_a_mistake_is_named_by_its_line(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert complaint(tmp_path, old, new).startswith(line)


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("rgbd_dataset_freiburg1_xyz", "1"),
        ("freiburg2", "2"),
        ("fr3", "3"),
        ("rgbd_dataset_freiburg3_long_office_household", "3"),
        ("FR1-desk", "1"),
    ],
)
def test_tum_cameras_are_known_by_folder_name(tmp_path: Path, name: str, camera: str) -> None:
    (tmp_path / name).mkdir()
    assert camera_of_folder(tmp_path / name, None) is KNOWN_CAMERAS[camera]


@pytest.mark.parametrize("name", ["kitchen", "freiburg4", "freiburg11", "afr1", "fr1x", "fr"])
def test_an_unknown_folder_has_no_default(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"no camera file.*write .*camera\.toml with the keys"):
        camera_of_folder(tmp_path / name, None)


def test_the_folder_here_is_known_by_its_real_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "freiburg2").mkdir()
    monkeypatch.chdir(tmp_path / "freiburg2")
    assert camera_of_folder(Path(), None) is KNOWN_CAMERAS["2"]


def test_the_file_in_the_folder_wins_over_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "freiburg1"
    folder.mkdir()
    (folder / "camera.toml").write_text(MILLIMETRES)
    assert camera_of_folder(folder, None).depth_factor == 1000.0


def test_the_file_given_wins_over_the_one_in_the_folder(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(MILLIMETRES)
    given_file = tmp_path / "mine.toml"
    given_file.write_text(TEXT)
    assert camera_of_folder(tmp_path, given_file).depth_factor == 5000.0


def test_a_camera_file_that_cannot_be_read_is_never_passed_over(tmp_path: Path) -> None:
    folder = tmp_path / "freiburg1"
    folder.mkdir()
    (folder / "camera.toml").symlink_to(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="cannot be read"):
        camera_of_folder(folder, None)
