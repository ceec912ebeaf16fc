"""The trajectory file."""

import logging
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError, UserFacingError
from drivers.core.geometry import read_trajectory
from drivers.core.queues import BlockingQueue, DropOldestQueue
from tests.full_disk import limit_file_size
from tests.vo_service.cli.cli_runner import count_lines
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.waiting import wait_until
from vo_service.outputs.trajectory.trajectory_file import TrajectoryFileOutput


def test_every_good_frame_becomes_one_line(tmp_path: Path) -> None:
    output = TrajectoryFileOutput(tmp_path / "out.txt", BlockingQueue(8))
    for seq in range(5):
        output.on_update(make_update(seq, ok=seq != 2))
        output.on_status(STATUS)
    output.close()
    poses = read_trajectory(tmp_path / "out.txt")
    good = [make_update(seq) for seq in (0, 1, 3, 4)]
    np.testing.assert_allclose(poses.stamps_s, [u.stamp_s for u in good], atol=1e-6)
    np.testing.assert_allclose(poses.T_world_camera, [u.T_world_camera for u in good], atol=1e-7)


def test_after_a_clock_was_set_back_the_lines_are_sorted_at_the_end(tmp_path: Path) -> None:
    output = TrajectoryFileOutput(tmp_path / "out.txt", BlockingQueue(8))
    for seq, stamp_s in enumerate((5.0, 6.0, 2.0, 3.0, 5.0)):
        output.on_update(replace(make_update(seq), stamp_s=stamp_s))
    output.close()
    poses = read_trajectory(tmp_path / "out.txt")
    np.testing.assert_array_equal(poses.stamps_s, [2.0, 3.0, 5.0, 6.0])
    of_the_last = make_update(4).T_world_camera
    np.testing.assert_allclose(poses.T_world_camera[2], of_the_last, atol=1e-7)


def test_lines_are_on_disk_before_close(tmp_path: Path) -> None:
    output = TrajectoryFileOutput(tmp_path / "out.txt", BlockingQueue(8))
    output.on_update(make_update(0))
    output.on_update(make_update(1))
    wait_until(lambda: count_lines(tmp_path / "out.txt") == 2)
    output.close()


def test_a_pipe_that_nothing_reads_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: nothing reads this pipe; start its reader first"):
        TrajectoryFileOutput(tmp_path / "pipe", BlockingQueue(8))


def test_the_reader_of_a_pipe_gets_the_lines(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    output = TrajectoryFileOutput(pipe, BlockingQueue(8))
    output.on_update(make_update(0))
    output.close()
    assert os.read(reader, 1000).count(b"\n") == 1
    os.close(reader)


def test_an_older_file_is_truncated_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old")
    TrajectoryFileOutput(path, BlockingQueue(8)).close()
    assert path.read_text() == ""


@pytest.mark.parametrize("name", ["", "missing/out.txt"])
def test_an_unwritable_path_is_rejected_at_once(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be written: ") as caught:
        TrajectoryFileOutput(tmp_path / name, BlockingQueue(8))
    assert str(tmp_path / name) in str(caught.value)


def test_a_full_disk_keeps_complete_lines_and_is_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    output = TrajectoryFileOutput(tmp_path / "out.txt", BlockingQueue(8))
    with limit_file_size(250):
        for seq in range(6):
            output.on_update(make_update(seq))
        wait_until(lambda: "the trajectory stops after" in output.warning)
    with pytest.raises(UserFacingError, match=r"out\.txt: the trajectory is incomplete"):
        output.close()
    output.close()
    assert len(read_trajectory(tmp_path / "out.txt")) == 2
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert "; the trajectory stops after" in caplog.text
    assert "free some space" in caplog.text


def test_a_reader_that_ends_is_not_told_to_free_space(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    output = TrajectoryFileOutput(pipe, BlockingQueue(8))
    os.close(reader)
    output.on_update(make_update(0))
    wait_until(lambda: "Broken pipe; the trajectory" in output.warning)
    assert "space" not in output.warning
    with pytest.raises(UserFacingError, match="the trajectory is incomplete"):
        output.close()


def test_a_blocked_disk_blocks_nothing_and_is_reported(tmp_path: Path) -> None:
    pipe = tmp_path / "out.txt"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    output = TrajectoryFileOutput(pipe, DropOldestQueue(4))
    for seq in range(2000):  # more than a pipe that nobody reads holds
        output.on_update(make_update(seq))
    assert "out.txt: the disk is too slow" in output.warning
    os.close(reader)  # the write that hangs fails now
    wait_until(lambda: "the trajectory stops" in output.warning)
    with pytest.raises(UserFacingError):
        output.close()
