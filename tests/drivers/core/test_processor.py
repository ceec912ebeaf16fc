"""Kernels that an image carries are used by processors that can run them, and ignored by others."""

import os
import platform
from pathlib import Path

import pytest

from drivers.core import processor
from drivers.core.folders import kernel_folder
from drivers.core.processor import (
    X86_64_LEVELS,
    add_carried_kernels,
    can_run,
    is_known,
    use_carried_kernels,
)

V2, V3 = (" ".join(list(X86_64_LEVELS.values())[:count]) for count in (1, 2))


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "environ", {"HOME": str(tmp_path)})


def computer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, flags: str) -> None:
    info = tmp_path / "cpuinfo"
    info.write_text(f"processor\t: 0\nmodel name\t: X\nflags\t\t: fpu {flags}\n\nprocessor\t: 1\n")
    monkeypatch.setattr(processor, "_CPU_INFO", info)


@pytest.mark.parametrize(("flags", "fits"), [(V2, False), (V3, True), ("", False)])
def test_a_level_of_x86_64_needs_the_flags_of_all_levels_below(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, flags: str, fits: bool
) -> None:
    computer(monkeypatch, tmp_path, flags)
    assert can_run("x86-64-v3") is fits


def test_a_processor_runs_what_is_compiled_for_its_own_name_only() -> None:
    from llvmlite import binding

    assert can_run(binding.get_host_cpu_name())
    assert not can_run("another")


def test_the_compiler_knows_its_processors() -> None:
    known = "x86-64-v3" if platform.machine() == "x86_64" else "cortex-a72"
    assert is_known(known)


@pytest.mark.parametrize("name", ["", "help", "pentium-9", "i686"])
def test_a_processor_that_the_compiler_cannot_compile_for_is_not_known(name: str) -> None:
    assert not is_known(name)


@pytest.mark.parametrize(("flags", "used"), [(V2, False), (V3, True)])
def test_carried_kernels_are_used_where_they_fit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, flags: str, used: bool
) -> None:
    computer(monkeypatch, tmp_path, flags)
    (tmp_path / "processor").write_text("x86-64-v3\n")
    before = kernel_folder()
    use_carried_kernels(tmp_path)
    assert (os.environ.get("NUMBA_CPU_NAME") == "x86-64-v3") is used
    assert (kernel_folder() != before) is used


@pytest.mark.parametrize("order", [("x86-64-v2", "x86-64-v3"), ("x86-64-v3", "x86-64-v2")])
@pytest.mark.parametrize(("flags", "used"), [(V2, "x86-64-v2"), (V3, "x86-64-v3")])
def test_of_several_kinds_the_best_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, order: tuple[str, str], flags: str, used: str
) -> None:
    computer(monkeypatch, tmp_path, flags)
    for name in order:
        add_carried_kernels(tmp_path, name)
    use_carried_kernels(tmp_path)
    assert os.environ["NUMBA_CPU_NAME"] == used


def test_the_users_variable_has_precedence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    computer(monkeypatch, tmp_path, V3)
    (tmp_path / "processor").write_text("x86-64-v3\n")
    os.environ["NUMBA_CPU_NAME"] = "generic"
    use_carried_kernels(tmp_path)
    assert os.environ["NUMBA_CPU_NAME"] == "generic"


def test_another_processor_has_another_kernel_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folders = []
    for flags in (V2, V3, V3):
        computer(monkeypatch, tmp_path, flags)
        folders.append(kernel_folder())
    assert folders[0] != folders[1] == folders[2]
