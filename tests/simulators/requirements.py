"""Native libraries and programs that tests need: skip without them, unless all are installed."""

import ctypes
import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

# Set where everything is installed, so that no test is left out without anyone noticing.
ALL_INSTALLED = "KINECT_VO_ALL_INSTALLED"
FAKENECT = "fakenect/libfreenect.so.0.5"


def skip_or_fail(reason: str) -> NoReturn:
    """Skip the test; fail it where everything is said to be installed."""
    if os.environ.get(ALL_INSTALLED):
        pytest.fail(f"{ALL_INSTALLED} is set, but: {reason}")
    pytest.skip(reason)


def require_library(name: str, package: str) -> None:
    """The test needs a library that is loaded by its name."""
    try:
        ctypes.CDLL(name)
    except OSError as error:
        skip_or_fail(f"needs {name}: apt install {package} ({error})")


def require_fakenect() -> Path:
    """The test needs fakenect: its file."""
    found = sorted(Path("/usr/lib").glob(f"**/{FAKENECT}"))
    if not found:
        skip_or_fail("needs fakenect: apt install libfreenect0.5")
    return found[0]


def require_program(name: str, package: str) -> str:
    """The test needs a program: where it is."""
    found = shutil.which(name)
    if found is None:
        skip_or_fail(f"needs {name}: apt install {package}")
    return found
