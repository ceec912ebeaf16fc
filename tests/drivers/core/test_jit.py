"""Compiling numeric kernels: it can be interrupted, and loads no more than it needs."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from drivers.core.folders import KERNEL_SOURCES, SOURCE_PACKAGES
from drivers.core.jit import interruptible
from tests.test_import_circles import MODULES, imported

ROOT = Path(__file__).parents[3]


def stop() -> None:
    raise KeyboardInterrupt


def test_no_kernel_is_compiled_after_the_check_raises() -> None:
    double = numba.njit(lambda x: 2 * x)
    with pytest.raises(KeyboardInterrupt), interruptible(stop):
        double(1)
    assert double.signatures == []
    assert double(1) == 2


def test_a_compiled_kernel_is_not_checked() -> None:
    double = numba.njit(lambda x: 2 * x)
    double(1)
    with interruptible(stop):
        assert double(2) == 4


def test_scipy_linear_algebra_is_loaded_only_by_its_users() -> None:
    code = """if True:
        import sys, numba, numpy
        from drivers.synthetic.sensors import distort
        distort(0.1, 0.2, numpy.zeros(5))
        assert "scipy.linalg" not in sys.modules
        numba.njit(lambda a: a @ a)(numpy.eye(3))
        assert "scipy.linalg" in sys.modules
    """
    subprocess.run([sys.executable, "-c", code], check=True)


PROGRAM = """
from drivers.core.jit import kernel

@kernel
def double(x):
    return 2 * x

print(double(3))
"""


FOUR_KERNELS = """
from drivers.core.jit import kernel

@kernel
def one(x):
    return x

@kernel
def two(x):
    return 2 * x

@kernel
def three(x):
    return 3 * x

@kernel
def four(x):
    return 4 * x

print(one(3), two(3), three(3), four(3))
"""
DAMAGED = {"one": ("nbc", b""), "two": ("nbi", b""), "three": ("nbc", bytes(2000))}
DAMAGED |= {"four": ("nbi", bytes(2000))}


@pytest.mark.subprocess
def test_a_kernel_with_a_damaged_file_is_compiled_anew(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(FOUR_KERNELS)
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "kernels"),
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, str(tmp_path / "program.py")]
    subprocess.run(command, env=environment, check=True)
    for name, (suffix, content) in DAMAGED.items():
        (file,) = (tmp_path / "kernels").rglob(f"program.{name}*.{suffix}")
        file.write_bytes(content)
    for warnings in (len(DAMAGED), 0):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.stdout == "3 6 9 12\n"
        assert done.stderr.count("a damaged kernel is compiled anew") == warnings


CALLER = """
import sys
from program import double, kernel

@kernel
def quadruple(x):
    return double(double(x))

double(3)  # loads it from the cache
assert double._cache_hits
assert "numba.core.typing.arraydecl" not in sys.modules  # the compiler is not prepared
assert quadruple(3) == 12
"""


@pytest.mark.subprocess
def test_a_user_program_shares_the_kernel_cache_and_prepares_no_compiler_for_a_loaded_kernel(
    tmp_path: Path,
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "caller.py").write_text(CALLER)
    environment = {name: text for name, text in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"CACHE_DIRECTORY": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    subprocess.run(
        [sys.executable, "-c", "import program"], cwd=tmp_path, env=environment, check=True
    )
    assert list((tmp_path / "cache" / "kernels").rglob("program.double*.nbi"))
    subprocess.run([sys.executable, "caller.py"], cwd=tmp_path, env=environment, check=True)


def is_kernel_source(file: Path) -> bool:
    return any(file.is_relative_to(ROOT / source) for source in KERNEL_SOURCES)


def test_kernels_are_compiled_anew_after_a_change_of_what_they_import() -> None:
    files = [file for package in SOURCE_PACKAGES for file in (ROOT / package).rglob("*.py")]
    kernels = [file for file in files if re.search(r"core\.jit import .*kernel", file.read_text())]
    assert len(kernels) > 20
    assert [str(file) for file in kernels if not is_kernel_source(file)] == []
    outside = {
        name for file in kernels for name in imported(file) if not is_kernel_source(MODULES[name])
    }
    assert outside == set()
