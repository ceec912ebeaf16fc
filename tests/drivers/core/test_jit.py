"""Compiling numeric kernels: it can be interrupted, and loads no more than it needs."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from drivers.core.jit import interruptible

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
        from drivers.synthetic.depth_sensor import distort
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


@pytest.mark.subprocess
def test_a_user_program_shares_the_kernel_cache_of_the_command_line(
    tmp_path: Path,
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    environment = {name: text for name, text in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    subprocess.run(
        [sys.executable, str(tmp_path / "program.py")],
        env=environment | {"CACHE_DIRECTORY": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)},
        check=True,
    )
    assert list((tmp_path / "cache" / "kernels").rglob("program.double*.nbi"))
