"""Recordings of bounded size and number, also on a full disk."""

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from drivers.camera import PlaybackMode
from drivers.core import InputError, UserFacingError, write_errors
from drivers.core.files import rotate_file
from drivers.core.geometry import Trajectory
from tests.full_disk import limit_file_size
from tests.resource_leaks import resident_memory_kb
from tests.vo_service.outputs.rerun.rerun_recording import (
    count_rows,
    draw,
    is_complete,
    make_config,
    read_column,
)
from tests.vo_service.outputs.sample_updates import make_update
from tests.waiting import wait_until
from vo_service.outputs import write_fault
from vo_service.outputs.rerun import output as rerun_output
from vo_service.outputs.rerun import rotating_recording, sinks
from vo_service.outputs.rerun.blueprint import make_blueprint
from vo_service.outputs.rerun.output import RerunOutput
from vo_service.outputs.rerun.rotating_recording import RotatingRecording
from vo_service.outputs.rerun.sinks import BrokenFileError, RrdFileSink
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.rerun


@pytest.fixture
def make_large_update() -> Callable[[int], OdometryUpdate]:
    """Results with a noise image of one megabyte: ``make_large_update(seq)``."""
    noise = np.random.default_rng(0).integers(0, 255, (960, 1280, 3), np.uint8)

    def make(seq: int) -> OdometryUpdate:
        update = make_update(3 * seq)
        return dataclasses.replace(update, frame=dataclasses.replace(update.frame, color_bgr=noise))

    return make


@pytest.fixture
def free_bytes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Free disk sizes, one per check; the last one repeats."""
    free_sizes = [10**12]

    def free_bytes(path: Path) -> int:
        return free_sizes.pop(0) if len(free_sizes) > 1 else free_sizes[0]

    monkeypatch.setattr(rotating_recording, "CHECK_PERIOD_S", 0.0)
    monkeypatch.setattr(write_fault, "RETRY_PERIOD_S", 0.0)
    monkeypatch.setattr(write_errors, "free_disk_bytes", free_bytes)
    return free_sizes


@pytest.fixture
def written_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make Rerun write a hundred times a second, not five."""
    monkeypatch.setenv("RERUN_FLUSH_TICK_SECS", "0.01")


def paced(updates: Iterable[OdometryUpdate], folder: Path) -> Iterator[OdometryUpdate]:
    """Yield results no faster than Rerun writes them to the files of a folder."""
    for update in updates:
        before = sizes(folder)
        yield update
        wait_until(partial(_differ, folder, before))


def sizes(folder: Path) -> dict[str, int]:
    """Return the size of every file of a folder."""
    return {file.name: file.stat().st_size for file in folder.iterdir()}


def _differ(folder: Path, before: dict[str, int]) -> bool:
    return sizes(folder) != before


@pytest.mark.subprocess
@pytest.mark.usefixtures("written_at_once")
def test_a_full_file_is_followed_by_the_next_and_the_oldest_is_deleted(
    tmp_path: Path, make_large_update: Callable[[int], OdometryUpdate]
) -> None:
    path = tmp_path / "out.rrd"
    draw(
        RrdFileSink(path, file_mb=1, files_kept=3),
        paced(map(make_large_update, range(20)), tmp_path),
    )
    names = sorted(file.name for file in tmp_path.iterdir())
    assert len(names) == 3
    assert names[-1] == "out.rrd"
    newest = int(names[1][4:8])
    assert names[0] == f"out-{newest - 1:04d}.rrd"
    assert newest > 2
    assert all(map(is_complete, tmp_path.iterdir()))


@pytest.mark.usefixtures("written_at_once")
def test_every_file_opens_by_itself_and_continues_the_trajectory(
    tmp_path: Path, make_large_update: Callable[[int], OdometryUpdate]
) -> None:
    updates = [make_large_update(seq) for seq in range(8)]
    stamps_s = np.array([update.stamp_s for update in updates])
    truth = Trajectory(stamps_s, np.array([update.T_world_camera for update in updates]))
    draw(RrdFileSink(tmp_path / "out.rrd", file_mb=1), paced(updates, tmp_path), ground_truth=truth)
    assert len(list(tmp_path.iterdir())) > 1
    for file in tmp_path.iterdir():
        counted = count_rows(file)
        for entity in ("world", "world/ground_truth", "plots/counts/inliers"):
            assert counted[f"/{entity}"] > 0, (file.name, entity)
        assert counted["/log"] == 1  # the state, logged again
        assert len(RrdReader(file).blueprints()) == 1
    so_far = read_column(tmp_path / "out.rrd", "/world/trajectory/so_far", "LineStrips3D:strips")
    assert len(so_far[0][0]) > 2
    assert so_far[0][0][0] == [0.0, 0.0, 0.0]


def test_many_files_take_no_more_memory(tmp_path: Path) -> None:
    stream, files = rr.RecordingStream("rotating"), RrdFileSink(tmp_path / "out.rrd")
    memory_kb = []
    for _ in range(25):
        files.attach(stream, make_blueprint())
        stream.log("word", rr.TextLog("one"))
        files.check(stream)
        stream.disconnect()
        memory_kb.append(resident_memory_kb(os.getpid()))
    assert memory_kb[-1] - memory_kb[4] < 10_000


def test_existing_files_are_kept(tmp_path: Path) -> None:
    for number in range(3):
        draw(RrdFileSink(tmp_path / "out.rrd"), [make_update(number)])
    assert [count_rows(tmp_path / name)["/log"] for name in ("out-0001.rrd", "out-0002.rrd")] == [
        1,
        1,
    ]
    positions = read_column(tmp_path / "out.rrd", "/world/camera", "Transform3D:translation")
    assert positions[0][0][2] == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("there", "kept", "left"),
    [
        ([], 4, []),
        (["out.rrd"], 4, ["out-0001.rrd"]),
        (["out.rrd"], 1, []),
        (["out.rrd", "out-0007.rrd", "out-0005.rrd"], 3, ["out-0007.rrd", "out-0008.rrd"]),
        (["out-9999.rrd", "out.rrd"], 3, ["out-9999.rrd", "out-10000.rrd"]),
        (["other.rrd", "out-1.rrd", "out-0001.txt"], 1, ["other.rrd", "out-1.rrd", "out-0001.txt"]),
    ],
)
def test_only_our_own_files_are_deleted(
    tmp_path: Path, there: list[str], kept: int, left: list[str]
) -> None:
    for name in there:
        (tmp_path / name).touch()
    rotate_file(tmp_path / "out.rrd", kept)
    assert {file.name for file in tmp_path.iterdir()} == set(left)


@pytest.mark.subprocess
def test_a_full_disk_closes_the_file_and_starts_another_when_there_is_space(
    tmp_path: Path, free_bytes: list[int]
) -> None:
    path = tmp_path / "out.rrd"
    free_bytes[:] = [10**12] * 4 + [10**6, 10**6, 10**12]
    recording = draw(RrdFileSink(path), [make_update(3 * seq) for seq in range(10)])
    assert recording.fault == ""
    assert "out.rrd: the disk is full" in recording.data_loss
    assert is_complete(path)
    assert is_complete(tmp_path / "out-0001.rrd")
    assert count_rows(tmp_path / "out-0001.rrd")["/depth"] == 3
    assert count_rows(path)["/depth"] == 5


def test_a_disk_that_is_full_at_the_start_is_a_fault_but_no_error(
    tmp_path: Path, free_bytes: list[int]
) -> None:
    free_bytes[:] = [10**6]
    recording = draw(RrdFileSink(tmp_path / "out.rrd"), [make_update(0)])
    assert "the disk is full" in recording.fault
    assert list(tmp_path.iterdir()) == []


@pytest.mark.subprocess
def test_a_file_that_cannot_grow_is_readable_so_far_and_the_process_ends_by_itself(
    tmp_path: Path,
    make_large_update: Callable[[int], OdometryUpdate],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(rerun_output, "CLOSE_TIMEOUT_S", 4.0)
    path = tmp_path / "out.rrd"
    # The first batch may have three updates of 2 MB.
    with limit_file_size(10_000_000):
        output = RerunOutput(RrdFileSink(path), playback_mode=PlaybackMode.LOCKSTEP)
    updates = map(make_large_update, count())

    sizes = {path.stat().st_size}

    def has_written_or_stopped() -> bool:
        return path.stat().st_size not in sizes or "the recording stops after" in output.warning

    while "the recording stops after" not in output.warning:
        sizes.add(path.stat().st_size)
        output.on_update(next(updates))
        # Rerun collects data for a while; one batch must not exceed the limit.
        wait_until(has_written_or_stopped)
    assert "bytes: the disk is full" in output.warning
    with pytest.raises(UserFacingError, match="the recording is incomplete"):
        output.close()
    assert "too slow" not in caplog.text
    with pytest.warns(RerunWarning, match="no footer"):
        assert count_rows(path)["/world/camera/image"] > 0
    assert [file.name for file in tmp_path.iterdir()] == ["out.rrd"]


class StreamOfFailedFile:
    """A stream whose file could not be written: its flush waits `wait_s`, and then fails."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, wait_s: float) -> None:
        self.now_s, self._wait_s = 0.0, wait_s
        monkeypatch.setattr(sinks, "time", SimpleNamespace(monotonic=lambda: self.now_s))

    def flush(self, timeout_sec: float) -> None:
        self.now_s += min(self._wait_s, timeout_sec)
        raise RuntimeError("no")


@pytest.mark.parametrize(
    ("free", "wait_s", "cause", "longest_s"),
    [
        (10**6, 10.0, "the disk is full", sinks.FLUSH_STEP_S),
        (10**12, 10.0, "the file cannot be written", sinks.FLUSH_TIMEOUT_S),
        (10**12, 0.0, "the file cannot be written", 0.0),
    ],
)
def test_a_failed_file_is_waited_for_only_while_it_may_recover(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    free_bytes: list[int],
    free: int,
    wait_s: float,
    cause: str,
    longest_s: float,
) -> None:
    free_bytes[:] = [free]
    (tmp_path / "out.rrd").write_bytes(b"half a message")
    stream: Any = StreamOfFailedFile(monkeypatch, wait_s)
    with pytest.raises(BrokenFileError, match=f"stops after 0 bytes: {cause}"):
        RrdFileSink(tmp_path / "out.rrd").check(stream)
    assert stream.now_s <= longest_s
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_not_utf8_is_one_line_and_existing_files_stay(tmp_path: Path) -> None:
    path = tmp_path / "not\udcffutf8.rrd"
    path.touch()
    with pytest.raises(InputError, match="cannot write the Rerun recording") as caught:
        RotatingRecording(make_config(RrdFileSink(path)))
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("folder.rrd", "it is a folder; name another file"),
        ("device.rrd", "it is not a regular file; name another file"),
        ("none/a.rrd", "none; create it first"),
        ("file/a.rrd", "Not a directory; use another name"),
        ("/proc/a.rrd", "cannot be written: No such file or directory; check its folder"),
        ("/sys/a.rrd", "cannot be written: "),
    ],
)
def test_an_unwritable_file_is_reported_with_its_cause(
    tmp_path: Path, name: str, cause: str
) -> None:
    (tmp_path / "folder.rrd").mkdir()
    (tmp_path / "device.rrd").symlink_to("/dev/full")
    (tmp_path / "file").touch()
    there = set(tmp_path.rglob("*"))
    with pytest.raises(UserFacingError, match=r"\.rrd: cannot ") as caught:
        RotatingRecording(make_config(RrdFileSink(tmp_path / name)))
    assert cause in str(caught.value)
    assert set(tmp_path.rglob("*")) == there
