"""Native libraries and programs that tests need; tests are skipped without them."""

import ctypes
import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

# Set where everything is installed: a missing library then fails the test instead of skipping it.
ALL_INSTALLED = "KINECT_VO_ALL_INSTALLED"
FAKENECT = "fakenect/libfreenect.so.0.5"


def skip_or_fail(reason: str) -> NoReturn:
    """Skip the test; fail it if `ALL_INSTALLED` is set."""
    if os.environ.get(ALL_INSTALLED):
        pytest.fail(f"{ALL_INSTALLED} is set, but: {reason}")
    pytest.skip(reason)


def require_library(name: str, package: str) -> None:
    """Skip the test unless a library can be loaded by its name."""
    try:
        ctypes.CDLL(name)
    except OSError as error:
        skip_or_fail(f"needs {name}: apt install {package} ({error})")


def require_fakenect() -> Path:
    """Return the file of fakenect; skip the test if there is none."""
    files = sorted(Path("/usr/lib").glob(f"*/{FAKENECT}"))
    if not files:
        skip_or_fail("needs fakenect: apt install libfreenect0.5")
    return files[0]


def require_program(name: str, package: str) -> str:
    """Return the path of a program; skip the test if there is none."""
    path = shutil.which(name)
    if path is None:
        skip_or_fail(f"needs {name}: apt install {package}")
    return path
