"""Trajectory files of other projects."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.core.geometry import (
    Array,
    Trajectory,
    format_pose_line,
    quaternion_from_rotation,
    rigid_transform,
    so3_exp,
)
from drivers.core.trajectory_files import read_trajectory_file

MIRRORED_Y = np.diag([1.0, -1.0, 1.0, 1.0])
angles = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)
positions = st.tuples(*[st.floats(-100.0, 100.0)] * 3)
poses = st.builds(lambda v, t: rigid_transform(so3_exp(v), t), angles, positions)
tracks = st.lists(poses, min_size=1, max_size=5).map(np.array)


def as_euroc(track: Array) -> str:
    lines = ["#timestamp [ns],p_RS_R_x [m],p_y,p_z,q_w,q_x,q_y,q_z,v_x,v_y,v_z"]
    for number, T in enumerate(track):
        x, y, z, w = quaternion_from_rotation(T[:3, :3])
        numbers = [*T[:3, 3], w, x, y, z, 0.0, 0.0, 0.0]
        lines.append(f"{1403636579763555584 + number * 10**9},{','.join(map(repr, numbers))}")
    return "\r\n".join(lines).replace("np.float64(", "").replace(")", "")


def as_orb_slam(track: Array) -> str:
    lines = (format_pose_line(1403636579.0 + n, T).split(" ", 1) for n, T in enumerate(track))
    return "".join(f"{stamp.replace('.', '')}000.000000 {rest}" for stamp, rest in lines)


def as_kitti(track: Array) -> str:
    return "\n".join(" ".join(f"{v:.6e}" for v in T[:3].ravel()) for T in track)


def as_redwood(track: Array) -> str:
    blocks = (f"{n}\t{n}\t{n + 1}\n" + "\n".join(" ".join(f"{v:.8f}" for v in row) for row in T)
              for n, T in enumerate(track))  # fmt: skip
    return "\n".join(blocks) + "\n"


def as_icl_nuim(track: Array) -> str:
    return "".join(
        format_pose_line(n + 1, MIRRORED_Y @ T @ MIRRORED_Y).replace(".000000 ", " ", 1)
        for n, T in enumerate(track)
    )


@pytest.mark.parametrize(
    ("name", "write", "note", "first_s", "period_s"),
    [
        ("data.csv", as_euroc, "EuRoC format: nanoseconds", 1403636579.7635555, 1.0),
        ("poses.txt", as_orb_slam, "nanoseconds", 1403636579.0, 1.0),
        ("00.txt", as_kitti, "KITTI format, 30 Hz assumed", 0.0, 1 / 30),
        ("trajectory.log", as_redwood, "Redwood format, 30 Hz assumed", 0.0, 1 / 30),
        ("traj1.gt.freiburg", as_icl_nuim, "ICL-NUIM format, 30 Hz assumed", 1 / 30, 1 / 30),
    ],
)
@given(track=tracks)
def test_poses_and_stamps_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, name: str, write: Callable[[Array], str], note: str,
    first_s: float, period_s: float, track: Array,
) -> None:  # fmt: skip
    path = tmp_path_factory.getbasetemp() / name
    path.write_text(write(track))
    read = read_trajectory_file(path)
    assert read.note.startswith(note)
    expected_s = first_s + period_s * np.arange(len(track))
    np.testing.assert_allclose(read.poses.stamps_s, expected_s, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read.poses.T_world_camera, track, rtol=0, atol=1e-4)


def test_the_tum_format_is_read_without_a_note(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text("1.5 1 2 3 0 0 0 1\n")
    read = read_trajectory_file(tmp_path / "poses.txt")
    assert (read.note, read.poses.stamps_s.tolist()) == ("", [1.5])


TRACK = np.array([rigid_transform(np.eye(3), [n, 0, 0]) for n in range(3)])


def read(folder: Path, text: str, frames_s: list[float] | None = None) -> Trajectory:
    (folder / "poses.txt").write_text(text)
    stamps = None if frames_s is None else np.array(frames_s)
    return read_trajectory_file(folder / "poses.txt", stamps).poses


def test_kitti_takes_the_stamps_of_the_frames_or_of_times(tmp_path: Path) -> None:
    assert read(tmp_path, as_kitti(TRACK), [5.0, 6.0, 7.0]).stamps_s.tolist() == [5.0, 6.0, 7.0]
    (tmp_path / "times.txt").write_text("0\n1.036e-01\n2e-1\n")
    assert read(tmp_path, as_kitti(TRACK), [5.0, 6.0, 7.0]).stamps_s.tolist() == [0.0, 0.1036, 0.2]


def test_redwood_takes_the_stamps_of_its_frames(tmp_path: Path) -> None:
    assert read(tmp_path, as_redwood(TRACK), [5.0, 6.0]).stamps_s.tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 0 0 0 0 0 0 1 0\n", "FILE:1: 9 columns where 8 are expected"),
        ("1403636579763555584,0,0,0,0,0,0,0\n", "FILE:1: not a rotation"),
        ("1403636579763555584 0 0 0 0 0 0\n", "FILE:1: 7 columns where at least 8"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0\n", "FILE:2: 2 columns where 12 are expected"),
        ("1 0 0 0 0 1 0 0 0 0 2 0\n", "FILE:1: not a rotation and a translation"),
        ("1 0 0 0 0 1 0 0 0 0 nan 0\n", "FILE:1: not a rotation and a translation"),
        ("1 0 0 0 0 1 0 0 0 0 x 0\n", "FILE:1: could not convert string to float: 'x'"),
        ("0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n", "FILE:1: below it are not the four rows"),
        ("x 0 0\n" + "1 0 0 0\n" * 4, "FILE:1: expected three integers above"),
        ("1 2 3\n", "FILE:1: 3 columns where 8 are expected"),
        (as_redwood(TRACK) + "a b c\n", "FILE:16: expected three integers"),
        (as_redwood(TRACK[:1]) * 2, "FILE:6: stamp 0.0 is not after the previous one"),
    ],
)
def test_faults_are_reported_with_their_line(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert str(caught.value).replace(str(tmp_path / "poses.txt"), "FILE").startswith(expected)


def test_stamps_of_another_sequence_are_refused(tmp_path: Path) -> None:
    (tmp_path / "times.txt").write_text("0\n1\n")
    with pytest.raises(InputError, match=r"has 3 poses, but .*times.txt has 2 stamps"):
        read(tmp_path, as_kitti(TRACK))


def test_seconds_are_not_read_as_frame_numbers(tmp_path: Path) -> None:
    path = tmp_path / "traj0.gt.freiburg"
    path.write_text("1305031102.5 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r":1: 1305031102.5 is not the number of a frame"):
        read_trajectory_file(path)


@given(st.lists(st.lists(st.floats() | st.integers(), min_size=3, max_size=13), max_size=6))
def test_any_numbers_give_finite_poses_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[float]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "any_columns.txt"
    path.write_text("\n".join(" ".join(map(repr, row)) for row in rows))
    try:
        trajectory = read_trajectory_file(path).poses
    except InputError:
        return
    assert np.all(np.isfinite(trajectory.T_world_camera))


@pytest.mark.parametrize(("per_m", "is_named"), [(1.0, False), (1000.0, True)])
def test_positions_in_millimeters_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, per_m: float, is_named: bool
) -> None:
    lines = (f"{n / 30} {0.01 * per_m * n} 0 0 0 0 0 1\n" for n in range(5))
    file = tmp_path / "groundtruth.txt"
    file.write_text("".join(lines))
    read_trajectory_file(file)
    assert ("groundtruth.txt: the camera moves at 300 m/s" in caplog.text) is is_named


@pytest.mark.parametrize("per_s", [1e12, 1e15])  # of stamps like 1.3e9 s
def test_stamps_in_other_units_are_no_nanoseconds(tmp_path: Path, per_s: float) -> None:
    file = tmp_path / "poses.txt"
    unit = per_s / 1e9
    file.write_text("".join(f"{(1.3e9 + n / 30) * unit:.0f} 0 0 0 0 0 0 1\n" for n in range(9)))
    with pytest.raises(InputError, match=r"poses\.txt: its stamps are neither seconds nor nanosec"):
        read_trajectory_file(file)
