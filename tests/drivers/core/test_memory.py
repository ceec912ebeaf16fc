"""Giving memory back."""

import os
from pathlib import Path

import numba
import pytest

from drivers.core.memory import limit_freed_memory, release_memory


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_kernels_can_be_compiled_after_the_compiler_was_unloaded() -> None:
    assert numba.njit(lambda x: x + 1)(1) == 2
    before = resident_bytes()
    release_memory()
    assert resident_bytes() < before
    assert numba.njit(lambda x: x + 2)(1) == 3


def test_user_defined_limits_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"MALLOC_ARENA_MAX": "7", "MALLOC_MMAP_THRESHOLD_": "8", "MALLOC_TRIM_THRESHOLD_": "9"}
    for variable, value in limits.items():
        monkeypatch.setenv(variable, value)
    limit_freed_memory()
    assert limits.items() <= os.environ.items()
