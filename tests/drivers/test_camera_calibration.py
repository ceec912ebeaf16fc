import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.calibration import (
    TUM_CALIBRATIONS,
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
    find_calibration,
    format_calibration,
    read_calibration,
)
from drivers.core import InputError
from drivers.core.config import parse_toml
from drivers.core.geometry import is_rigid

TEXT = format_calibration(TUM_CALIBRATIONS["1"])
MILLIMETERS = TEXT.replace("depth_factor = 5000.0", "depth_factor = 1000.0")


def complaint(tmp_path: Path, old: str, new: str) -> str:
    assert old in TEXT
    file = tmp_path / "camera.toml"
    file.write_text(TEXT.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_calibration(file)
    return str(caught.value).removeprefix(str(tmp_path))


def unit_quaternion(direction: tuple[float, ...]) -> tuple[float, ...]:
    length = math.hypot(*direction)
    return tuple(part / length for part in direction)


distortions = st.tuples(*[st.floats(-1e3, 1e3)] * 5)
poses = st.builds(
    RigidTransform,
    st.tuples(*[st.floats(-10.0, 10.0)] * 3),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda direction: math.hypot(*direction) > 1e-3)
    .map(unit_quaternion),
)
depth_tables = st.builds(
    DepthCameraCalibration,
    fx=st.floats(1.0, 1e6),
    fy=st.floats(1.0, 1e6),
    cx=st.floats(-1e5, 1e5),
    cy=st.floats(-1e5, 1e5),
    T_color_depth=poses,
    distortion=distortions,
    width=st.integers(1, 16384),
    height=st.integers(1, 16384),
    scale=st.floats(0.5, 2.0),
)


@given(
    st.builds(
        CameraCalibration,
        st.integers(1, 16384),
        st.integers(1, 16384),
        *[st.floats(1.0, 1e6)] * 2,
        *[st.floats(-1e5, 1e5)] * 2,
        distortions,
        st.floats(1.0, 1e6),
        st.floats(0.0, 1.0),
        st.floats(-0.1, 0.1),
        st.none() | depth_tables,
    )
)
def test_a_written_file_is_read_back_exactly(camera: CameraCalibration) -> None:
    read = parse_toml(format_calibration(camera), "camera.toml", CameraCalibration)
    assert [repr(getattr(read, f.name)) for f in fields(read)] == [
        repr(getattr(camera, f.name)) for f in fields(camera)
    ]


def test_whole_numbers_and_comments_are_read(tmp_path: Path) -> None:
    text = TEXT.replace("fx = 517.3", "fx = 520  # pixels").replace("readout_s = 0.0", "")
    (tmp_path / "camera.toml").write_text(text.split("  # rolling")[0])
    assert read_calibration(tmp_path / "camera.toml").fx == 520.0


@given(poses, st.tuples(*[st.floats(-10.0, 10.0)] * 3))
def test_a_pose_rotates_and_translates_points(
    pose: RigidTransform, point: tuple[float, float, float]
) -> None:
    T = pose.matrix
    assert is_rigid(T)
    np.testing.assert_array_equal(T[:3, 3], pose.translation_m)
    turned = T[:3, :3] @ point
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(point), abs=1e-9)


DEPTH_TEXT = format_calibration(
    replace(
        TUM_CALIBRATIONS["3"],
        depth=DepthCameraCalibration(
            580.0, 579.0, 318.0, 242.0, RigidTransform((-0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        ),
    )
)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("fx = 580.0", 'fx = "580"', 'camera.toml:14: key `depth.fx`: "580" is the wrong type'),
        ("scale = 1.0", "scale = 3.0", "camera.toml:21: key `depth.scale`: 3.0 is out of range"),
        ("fy = 579.0", "", "camera.toml:13: key `depth.fy`: is missing; add `fy = ...`"),
        ("scale", "scales", "camera.toml:21: key `depth.scales`: is unknown; did you mean `scale`"),
        ("[-0.025,", "[-25.0,", "camera.toml:24: key `depth.T_color_depth.translation_m`: -25"),
        ("0.0, 1.0]", "0.0, 2.0]", "camera.toml:25: key `depth.T_color_depth.quaternion_xyzw`: mu"),
    ],
)
def test_a_mistake_in_the_depth_table_is_named_by_its_line(old: str, new: str, line: str) -> None:
    assert old in DEPTH_TEXT
    with pytest.raises(InputError) as caught:
        parse_toml(DEPTH_TEXT.replace(old, new, 1), "camera.toml", CameraCalibration)
    assert str(caught.value).startswith(line)


def test_optional_keys_of_a_depth_table() -> None:
    kept = [line for line in DEPTH_TEXT.splitlines() if not line.startswith(("scale", "readout"))]
    table = parse_toml("\n".join(kept), "camera.toml", CameraCalibration).depth
    assert table is not None
    assert (table.width, table.height, table.scale) == (640, 480, 1.0)


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
    assert find_calibration(tmp_path / name, None) is TUM_CALIBRATIONS[camera]


@pytest.mark.parametrize("name", ["kitchen", "freiburg4", "freiburg11", "afr1", "fr1x", "fr"])
def test_an_unknown_folder_has_no_default(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"no camera file.*write .*camera\.toml with the keys"):
        find_calibration(tmp_path / name, None)


def test_the_folder_here_is_known_by_its_real_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "freiburg2").mkdir()
    monkeypatch.chdir(tmp_path / "freiburg2")
    assert find_calibration(Path(), None) is TUM_CALIBRATIONS["2"]


def test_the_file_in_the_folder_overrides_its_name_and_a_given_file_both(tmp_path: Path) -> None:
    folder = tmp_path / "freiburg1"
    folder.mkdir()
    (folder / "camera.toml").write_text(MILLIMETERS)
    assert find_calibration(folder, None).depth_factor == 1000.0
    given_file = tmp_path / "mine.toml"
    given_file.write_text(TEXT)
    assert find_calibration(folder, given_file).depth_factor == 5000.0


def test_an_unreadable_camera_file_is_never_skipped(tmp_path: Path) -> None:
    folder = tmp_path / "freiburg1"
    folder.mkdir()
    (folder / "camera.toml").symlink_to(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="cannot be read"):
        find_calibration(folder, None)
