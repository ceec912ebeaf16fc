"""The trajectory file."""

import logging
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError, UserFacingError
from drivers.trajectory import read_trajectory
from vo_service.outputs.output import PoseUpdate, Status
from vo_service.outputs.trajectory_output import TrajectoryOutput

MakeUpdate = Callable[..., PoseUpdate]


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Let no file grow beyond `size` bytes: a full disk on request."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_every_good_frame_becomes_one_line(
    tmp_path: Path, make_update: MakeUpdate, status: Status
) -> None:
    output = TrajectoryOutput(tmp_path / "out.txt")
    for seq in range(5):
        output.pose(make_update(seq, ok=seq != 2))
        output.status(status)
    output.close()
    poses = read_trajectory(tmp_path / "out.txt")
    good = [make_update(seq) for seq in (0, 1, 3, 4)]
    np.testing.assert_allclose(poses.stamps_s, [u.frame.stamp_s for u in good], atol=1e-6)
    np.testing.assert_allclose(poses.T_world_camera, [u.T_world_camera for u in good], atol=1e-7)


def test_lines_are_on_disk_before_close(tmp_path: Path, make_update: MakeUpdate) -> None:
    output = TrajectoryOutput(tmp_path / "out.txt")
    output.pose(make_update(0))
    output.pose(make_update(1))
    assert len(read_trajectory(tmp_path / "out.txt")) == 2
    output.close()


def test_an_older_file_is_emptied_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old")
    TrajectoryOutput(path).close()
    assert path.read_text() == ""


@pytest.mark.parametrize("name", ["", "missing/out.txt"])
def test_a_path_that_cannot_be_written_is_refused_at_once(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot write the trajectory") as caught:
        TrajectoryOutput(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_a_full_disk_keeps_whole_lines_and_is_told_once(
    tmp_path: Path, make_update: MakeUpdate, caplog: pytest.LogCaptureFixture
) -> None:
    output = TrajectoryOutput(tmp_path / "out.txt")
    with file_size_limit(250):
        for seq in range(6):
            output.pose(make_update(seq))
    with pytest.raises(UserFacingError, match=r"out\.txt: the trajectory is not complete"):
        output.close()
    output.close()
    assert len(read_trajectory(tmp_path / "out.txt")) == 2
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert "out.txt: the trajectory stops after" in caplog.text
