"""Trajectory files: what is written reads back, and what is wrong is named by its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.core.geometry import (
    format_pose_line,
    read_trajectory,
    rigid_transform,
    rotation_angle_rad,
    so3_exp,
)

GOOD = "1.0 0 0 0 0 0 0 1\n"
angles = st.floats(-np.pi, np.pi)
meters = st.floats(-100.0, 100.0)


def complaint(folder: Path, text: str | bytes) -> str:
    """What the user reads of a file that is wrong, the file's name as FILE."""
    path = folder / "poses.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read_trajectory(path)
    message = str(caught.value).replace(str(path), "FILE")
    assert "\n" not in message
    return message


def test_a_line_holds_stamp_position_and_quaternion_x_y_z_w(tmp_path: Path) -> None:
    half_turn_about_x = rigid_transform(np.diag([1, -1, -1]), [4, 5, 6])
    quarter_turn_about_z = rigid_transform(so3_exp([0, 0, np.pi / 2]), [1, 2, 3])
    assert format_pose_line(0.5, quarter_turn_about_z) == (
        "0.500000 1.0000000 2.0000000 3.0000000 0.000000000 0.000000000 0.707106781 0.707106781\n"
    )
    path = tmp_path / "poses.txt"
    path.write_text("1.5 1 2 3 0 0 0.70710678 0.70710678\n2.5 4 5 6 1 0 0 0\n")
    poses = read_trajectory(path)
    assert poses.stamps_s.tolist() == [1.5, 2.5]
    assert len(poses) == 2
    assert np.allclose(poses.T_world_camera, [quarter_turn_about_z, half_turn_about_x], atol=1e-8)


@given(st.floats(0, 2e9), st.tuples(meters, meters, meters), st.tuples(angles, angles, angles))
def test_a_written_trajectory_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    stamp_s: float,
    position_m: tuple[float, ...],
    vector_rad: tuple[float, ...],
) -> None:
    T = rigid_transform(so3_exp(vector_rad), position_m)
    path = tmp_path_factory.getbasetemp() / "one_pose.txt"
    path.write_text(format_pose_line(stamp_s, T))
    poses = read_trajectory(path)
    back = poses.T_world_camera[0]
    assert poses.stamps_s[0] == pytest.approx(stamp_s, abs=1e-6, rel=0)
    assert np.allclose(back[:3, 3], position_m, rtol=0, atol=1e-7)
    assert rotation_angle_rad(back[:3, :3].T @ T[:3, :3]) < 5e-9


def test_comments_blank_lines_commas_and_a_byte_order_mark_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("\ufeff# a comment\n\n1,2,3,4,0,0,0,1 # the first\r\n  2 2 3 4 0 0 0 1\n")
    assert read_trajectory(path).stamps_s.tolist() == [1.0, 2.0]


def test_a_rounded_quaternion_is_a_rotation(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("1 0 0 0 0 0 0.7 0.72\n")
    R = read_trajectory(path).T_world_camera[0, :3, :3]
    assert np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 2 3 4 5 6 7\n", "FILE:1: 7 columns where 8 are expected"),
        (GOOD + "2 0 0 0 0 0 0 1 9\n", "FILE:2: 9 columns"),
        (GOOD + "\n2 0 0 nan 0 0 0 1\n", "FILE:3: a value is not finite"),
        (GOOD + "inf 0 0 0 0 0 0 1\n", "FILE:2: a value is not finite"),
        (GOOD + "2 0 0 0 0 0 0 0\n", "FILE:2: not a rotation: the quaternion has length 0, not 1"),
        (GOOD + "2 0 0 0 0 0 0 1.02\n", "FILE:2: not a rotation: the quaternion has length 1.02"),
        (GOOD + "2 0 0 x 0 0 0 1\n", "FILE:2: could not convert string to float: 'x'"),
        (GOOD + GOOD, "FILE:2: stamp 1.0 is not after the previous one (1.000000): sort"),
        (GOOD + "0.5 0 0 0 0 0 0 1\n", "FILE:2: stamp 0.5 is not after"),
        ("1305031449799600128 0 0 0 0 0 0 1\n", "FILE:1: stamps must be in seconds"),
        ("1 0 1e300 0 0 0 0 1\n", "FILE:1: stamps must be in seconds and positions in meters"),
        ("", "FILE: holds no pose; expected lines of: stamp tx ty tz qx qy qz qw"),
        ("# only a comment\n", "FILE: holds no pose"),
        (b"# \xe9\n1 0", "FILE:1: is not UTF-8 text (invalid continuation byte)"),
    ],
)
def test_errors_are_reported_with_their_line(
    tmp_path: Path, text: str | bytes, expected: str
) -> None:
    assert complaint(tmp_path, text).startswith(expected)


def test_a_missing_file_and_a_folder_are_rejected(tmp_path: Path) -> None:
    for path, cause in ((tmp_path / "gone.txt", "No such file"), (tmp_path, "it is a folder")):
        with pytest.raises(InputError) as caught:
            read_trajectory(path)
        assert str(caught.value).startswith(f"{path}: cannot be read: {cause}")


@given(st.binary(max_size=200))
def test_any_file_gives_poses_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "any_bytes.txt"
    path.write_bytes(data)
    try:
        poses = read_trajectory(path)
    except InputError:
        return
    assert np.all(np.isfinite(poses.T_world_camera))


@given(st.lists(st.lists(st.floats(), min_size=8, max_size=8), min_size=1, max_size=4))
def test_any_numbers_give_finite_poses_with_increasing_stamps_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[float]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "any_numbers.txt"
    path.write_text("\n".join(" ".join(map(repr, row)) for row in rows))
    try:
        poses = read_trajectory(path)
    except InputError:
        return
    assert np.all(np.diff(poses.stamps_s) > 0)
    assert np.all(np.isfinite(poses.T_world_camera))
