"""Giving memory back."""

import os
from pathlib import Path

import numba
import pytest

from drivers.core.jit import limit_freed_memory, release_memory


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_kernels_can_be_compiled_after_the_compiler_was_unloaded() -> None:
    assert numba.njit(lambda x: x + 1)(1) == 2
    before = resident_bytes()
    release_memory()
    assert resident_bytes() < before
    assert numba.njit(lambda x: x + 2)(1) == 3


def test_a_user_defined_number_of_arenas_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MALLOC_ARENA_MAX", "7")
    limit_freed_memory()
    assert os.environ["MALLOC_ARENA_MAX"] == "7"
