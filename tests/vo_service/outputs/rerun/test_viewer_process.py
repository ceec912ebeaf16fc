"""A frozen, killed, blocked or oversized viewer process never delays poses."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import PlaybackMode
from drivers.core import InputError, UserFacingError
from tests.resource_leaks import child_pids, is_alive, resident_memory_kb, resources_in_use
from tests.vo_service.outputs.rerun.faulty_sinks import (
    BlockingSink,
    FileReadingSink,
    FullDiskSink,
    LeakingSink,
)
from tests.vo_service.outputs.rerun.rerun_recording import count_rows, is_complete, read_column
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.waiting import wait_until
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.output import RerunOutput, open_rerun_output
from vo_service.outputs.rerun.sinks import RrdFileSink, Sink
from vo_service.outputs.rerun.targets import make_sink
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.subprocess

# Far longer than any call that does not wait for the viewer, even on a busy computer.
AT_ONCE_S = 10.0


@contextmanager
def running_output(
    sink: Sink,
    settings: RerunConfig = RerunConfig(),  # noqa: B008 (frozen)
    pace: PlaybackMode = PlaybackMode.REALTIME,
) -> Iterator[tuple[RerunOutput, int]]:
    """Run an output; yield it with its process id."""
    before = set(child_pids())
    output = RerunOutput(sink, settings, playback_mode=pace)
    try:
        (process,) = set(child_pids()) - before
        yield output, process
    finally:
        output.close()


def flood(output: RerunOutput, update: OdometryUpdate) -> float:
    """Send more results than a pipe holds; return the longest duration of a call."""
    longest_s = 0.0
    for seq in range(200):
        start_s = time.monotonic()
        output.on_update(replace(update, seq=seq))
        longest_s = max(longest_s, time.monotonic() - start_s)
    return longest_s


def show_until(output: RerunOutput, update: OdometryUpdate, warning: str) -> None:
    """Send results, as from a camera, until the output has this warning."""

    def has_warned() -> bool:
        output.on_update(update)
        return output.warning == warning

    wait_until(has_warned)


def test_results_reach_the_file_and_no_process_is_left(tmp_path: Path) -> None:
    before = resources_in_use()
    path = tmp_path / "out.rrd"
    with running_output(RrdFileSink(path), pace=PlaybackMode.LOCKSTEP) as (output, process):
        for seq in range(60):
            output.on_update(make_update(seq))
            if seq == 30:  # the service alone handles Ctrl-C and SIGTERM
                os.kill(process, signal.SIGINT)
                os.kill(process, signal.SIGTERM)
        output.on_status(STATUS)
        assert os.getpgid(process) != os.getpgrp()
    assert (output.dropped, output.warning) == (0, "")
    assert is_complete(path)
    assert (count_rows(path)["/world/camera"], count_rows(path)["/depth"]) == (60, 20)
    assert not is_alive(process)
    assert resources_in_use() <= before


def test_the_service_does_not_import_rerun(tmp_path: Path) -> None:
    script = (
        "import sys; from vo_service.outputs.rerun.output import open_rerun_output; "
        "open_rerun_output(sys.argv[1]).close(); "
        "print({'rerun', 'pyarrow', 'http.server'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "out.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (done.stdout, done.stderr) == ("set()\n", "")


def test_a_frozen_process_blocks_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    output = RerunOutput(RrdFileSink(tmp_path / "out.rrd"))
    (process,) = child_pids()
    os.kill(process, signal.SIGSTOP)
    assert flood(output, make_update(0)) < AT_ONCE_S
    assert output.dropped > 20
    start_s = time.monotonic()
    with pytest.raises(UserFacingError, match="incomplete"):
        output.close()
    assert time.monotonic() - start_s < 60.0  # 2.5 on a computer with nothing else to do
    assert "was too slow; the last data is lost" in caplog.text
    wait_until(lambda: not is_alive(process))


def test_a_killed_process_is_restarted_and_draws_earlier_results(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "out.rrd"
    with running_output(RrdFileSink(path), pace=PlaybackMode.LOCKSTEP) as (output, process):
        for seq in range(0, 60, 3):
            output.on_update(make_update(seq))
        wait_until(lambda: path.stat().st_size > 10_000)
        os.kill(process, signal.SIGKILL)
        wait_until(lambda: "crashed (signal 9, Killed)" in output.warning)
        wait_until(lambda: output.warning == "")
        for seq in range(60, 90, 3):
            output.on_update(make_update(seq))
        wait_until((tmp_path / "out-0001.rrd").exists)
    assert caplog.text.count("crashed (signal 9, Killed); starting it again") == 1
    assert is_complete(path)
    (so_far,) = read_column(path, "/world/trajectory/so_far", "LineStrips3D:strips")
    assert so_far[0][0] == [0.0, 0.0, 0.0]
    assert len(so_far[0]) > 5


def test_a_process_blocked_in_rerun_is_reported() -> None:
    with running_output(BlockingSink()) as (output, _):
        show_until(output, make_update(0), "rerun: blocked does not read its data")
        assert flood(output, make_update(0)) < AT_ONCE_S


def test_a_process_with_too_much_memory_is_restarted(caplog: pytest.LogCaptureFixture) -> None:
    settings = RerunConfig(memory_mb=300)
    sizes_mb = []
    with running_output(LeakingSink(100), settings) as (output, process):

        def has_ended() -> bool:
            sizes_mb.append(resident_mb(process))
            output.on_update(make_update(0))
            return not is_alive(process)

        wait_until(has_ended)
        wait_until(lambda: "exceeded 300 MB (rerun.memory_mb)" in output.warning)
        wait_until(lambda: output.warning == "")
    assert max(sizes_mb) < 300 + 200
    assert caplog.text.count("exceeded 300 MB") == 1


def test_pages_of_files_do_not_count_as_memory(tmp_path: Path) -> None:
    sink = FileReadingSink(tmp_path / "library", 200)
    with running_output(sink, RerunConfig(memory_mb=250)) as (output, process):

        def is_mapped() -> bool:
            output.on_update(make_update(0))
            return resident_mb(process) > 250

        wait_until(is_mapped)
        time.sleep(1.5)  # three times the period of the check
        assert is_alive(process)
        assert output.warning == ""


def resident_mb(process: int) -> float:
    try:
        return resident_memory_kb(process) * 1024 / 1e6
    except (OSError, AssertionError):  # it has just ended
        return 0.0


def test_lost_data_is_reported_during_the_fault_and_at_the_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    output = RerunOutput(FullDiskSink())
    show_until(
        output,
        make_update(0),
        "rerun: full: the disk is full (No space left on device); free some space; "
        "recording then continues",
    )
    output.on_update(make_update(30))
    with pytest.raises(UserFacingError, match="full: the recording is incomplete"):
        output.close()
    output.close()
    assert caplog.text.count("the disk is full") == 1


def test_while_paused_nothing_is_drawn_and_the_log_has_a_line(tmp_path: Path) -> None:
    path = tmp_path / "out.rrd"
    with running_output(RrdFileSink(path), pace=PlaybackMode.LOCKSTEP) as (output, _):
        for is_paused in (False, True, True, False):
            output.set_paused(is_paused)
            for seq in range(3):
                output.on_update(make_update(seq))
    assert count_rows(path)["/world/camera"] == 6
    texts = [text for (text,) in read_column(path, "/log", "TextLog:text")]
    assert texts == ["tracking (epoch 1)", "paused: the machine is too slow", "drawing again"]


@pytest.mark.parametrize(
    "target",
    [
        "missing/out.rrd", "connect:no port", "connect:robot:0", "connect:robot:65536", "serve?",
        "out.txt",
    ],
)  # fmt: skip
def test_an_invalid_target_is_one_line(tmp_path: Path, target: str) -> None:
    name = str(tmp_path / target) if "/" in target else target
    before = resources_in_use()
    with pytest.raises(InputError) as caught:
        open_rerun_output(name)
    assert "\n" not in str(caught.value)
    assert resources_in_use() <= before


def test_an_invalid_viewer_address_names_a_target_that_is_accepted() -> None:
    with pytest.raises(InputError, match=r"such as connect:127\.0\.0\.1:9876") as caught:
        make_sink("connect:robot")
    make_sink(str(caught.value).rpartition(" ")[2])


def test_without_rerun_the_error_names_the_install_command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("vo_service.outputs.rerun.targets.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'kinect-vo\[rerun\]'"):
        open_rerun_output(str(tmp_path / "out.rrd"))
