"""The figures of a profile, and the control groups that limit the service."""

from pathlib import Path

import pytest

from benchmarks import control_groups
from benchmarks.control_groups import limit_processes
from benchmarks.profiles import format_runs
from benchmarks.tracking import Accuracy


def make_run(ate_m: float | None, cpu_ms: float) -> Accuracy:
    return Accuracy(500, 1, 0, ate_m, None, 0.02, median_ms=cpu_ms, cpu_ms=2 * cpu_ms)


def test_a_row_has_the_medians_of_the_runs() -> None:
    runs = [make_run(0.03, 2.0), make_run(0.01, 5.0), make_run(0.02, 3.0)]
    assert format_runs("desk: small", runs).split() == [
        *("desk:", "small", "500", "1", "0", "20.00", "20.00", "3.00", "6.00")
    ]


def test_a_recording_that_is_too_short_has_no_error() -> None:
    assert format_runs("desk: small", [make_run(None, 2.0)]).split()[5] == "-"


def test_a_limited_process_is_in_the_groups_of_both_controllers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for controller in ("cpu", "memory"):
        (tmp_path / controller).mkdir()
    (tmp_path / "cpu" / "cpu.shares").touch()
    monkeypatch.setattr(control_groups, "CGROUPS", tmp_path)
    monkeypatch.setattr(control_groups, "_remove", lambda group, parent: None)
    with limit_processes(40.0, 1000) as group:
        group.add([7])
    cpu, memory = group.folders
    assert (cpu / "cpu.cfs_quota_us").read_text() == "40000"
    assert (memory / "memory.limit_in_bytes").read_text() == "1000000000"
    assert (cpu / "cgroup.procs").read_text() == (memory / "cgroup.procs").read_text() == "7"
