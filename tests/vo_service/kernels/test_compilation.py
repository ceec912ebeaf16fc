"""Kernels are compiled once, callees first, in processes that end with the compilation."""

import os
import signal
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from tests.full_disk import limit_file_size
from vo_service.kernels import compilation
from vo_service.kernels.compilation import ensure_compiled, find_callees, process_count
from vo_service.kernels.kernel_list import read_kernel_list

PART = "frame packing"  # which has two kernels


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path


def child_processes() -> set[str]:
    own = Path("/proc/self/task")
    return {pid for task in own.iterdir() for pid in (task / "children").read_text().split()}


def ignore(_progress: str) -> None:
    pass


@pytest.mark.subprocess
def test_kernels_are_compiled_once(empty_cache: Path) -> None:
    progress: list[str] = []
    ensure_compiled([PART], progress.append)
    assert list(empty_cache.rglob("frame_packing._pack_steps*.nbc"))
    assert progress[0] == "0 of 2"
    ensure_compiled([PART], pytest.fail)


@pytest.mark.subprocess
@pytest.mark.usefixtures("empty_cache")
def test_an_interrupted_compilation_leaves_no_process_and_is_repeated() -> None:
    def interrupt(_progress: str) -> None:
        raise KeyboardInterrupt

    before = child_processes()
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            ensure_compiled([PART], interrupt)
    assert child_processes() == before


@pytest.mark.subprocess
@pytest.mark.usefixtures("empty_cache")
def test_a_killed_process_is_reported_in_one_line() -> None:
    before = child_processes()

    def kill(_progress: str) -> None:
        for pid in child_processes() - before:
            os.kill(int(pid), signal.SIGKILL)

    with pytest.raises(UserFacingError, match=r"crashed \(signal 9.*free some memory"):
        ensure_compiled([PART], kill)


@pytest.mark.subprocess
@pytest.mark.usefixtures("empty_cache")
def test_a_full_disk_is_an_error() -> None:
    with limit_file_size(4096), pytest.raises(OSError, match="File too large"):
        ensure_compiled([PART], ignore)


def test_a_method_without_kernels_needs_no_process(empty_cache: Path) -> None:
    ensure_compiled(["plug-in"], pytest.fail)


def test_the_kernels_that_a_kernel_calls_come_before_it() -> None:
    signatures = [each.signature for each in read_kernel_list() if each.part == "direct"]
    names = [each.kernel.rpartition(".")[2] for each in signatures]
    callees = {names[each] for each in find_callees(signatures)[names.index("solve_level")]}
    assert {"accumulate", "solve_cholesky"} <= callees


@pytest.mark.parametrize(("cores", "memory_gb", "count"), [(4, 8, 4), (4, 1, 2), (2, 0.1, 1)])
def test_there_is_a_process_for_each_core_that_has_memory(
    monkeypatch: pytest.MonkeyPatch, cores: int, memory_gb: float, count: int
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(cores)))
    monkeypatch.setattr(compilation, "available_memory_bytes", lambda: memory_gb * 1e9)
    assert process_count() == count
