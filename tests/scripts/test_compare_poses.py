"""The comparison of two trajectories of the same frames."""

from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import Trajectory, format_trajectory, so3_exp, transform_from_pose
from scripts.compare_poses import main

POSES = np.stack([transform_from_pose((0.1 * n, 0, 1), (0, 0, 0, 1)) for n in range(10)])
STAMPS_S = np.arange(10) / 30


def write(path: Path, T_world_camera: np.ndarray, stamps_s: np.ndarray = STAMPS_S) -> str:
    path.write_bytes(format_trajectory(Trajectory(stamps_s, T_world_camera)))
    return str(path)


@pytest.fixture
def file(tmp_path: Path) -> str:
    return write(tmp_path / "one.txt", POSES)


def test_the_largest_difference_of_a_pose_is_printed(
    file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    others = POSES.copy()
    others[4, :3, 3] += (3e-5, 0, -4e-5)
    main(file, write(tmp_path / "other.txt", others))
    printed = capsys.readouterr().out
    assert printed == "10 poses differ by at most 0.0500 mm and 0.00000 degrees\n"


def test_a_pose_that_is_elsewhere_fails(file: str, tmp_path: Path) -> None:
    others = POSES.copy()
    others[9, 0, 3] += 1.1e-4
    with pytest.raises(SystemExit, match=r"differ by more than 0[.]1 mm or 0[.]01 degrees"):
        main(file, write(tmp_path / "other.txt", others))


def test_a_pose_that_is_turned_fails(file: str, tmp_path: Path) -> None:
    others = POSES.copy()
    others[9, :3, :3] = so3_exp((0, 2e-4, 0))
    with pytest.raises(SystemExit, match="differ by more than"):
        main(file, write(tmp_path / "other.txt", others))


@pytest.mark.parametrize("frames", [slice(9), slice(1, 10)])
def test_a_trajectory_of_other_frames_fails(frames: slice, file: str, tmp_path: Path) -> None:
    other = write(tmp_path / "other.txt", POSES[frames], STAMPS_S[frames])
    with pytest.raises(SystemExit, match="are not of the same frames"):
        main(file, other)
