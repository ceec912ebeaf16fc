"""Functions that are called in a subprocess."""

import ctypes
import os
import time
from functools import partial

import pytest

from drivers.core import UserFacingError
from vo_service.tools.doctor.library_checks import load_libraries
from vo_service.tools.doctor.stream_probe import call_in_subprocess

pytestmark = pytest.mark.subprocess

LONG_S = 100.0


def test_the_result_comes_back() -> None:
    assert call_in_subprocess(partial(divmod, 17, 5), LONG_S) == (3, 2)


def test_it_is_another_process() -> None:
    assert call_in_subprocess(os.getppid, LONG_S) == os.getpid()


def test_a_crash_is_named() -> None:
    with pytest.raises(UserFacingError, match="crashed with SIGSEGV"):
        call_in_subprocess(partial(ctypes.string_at, 0), LONG_S)


def test_a_hanging_function_is_killed() -> None:
    with pytest.raises(UserFacingError, match=r"no answer within 0\.5 s"):
        call_in_subprocess(partial(time.sleep, 600), 0.5)


def test_an_error_is_reported_in_one_line() -> None:
    with pytest.raises(UserFacingError, match="failed: ZeroDivisionError"):
        call_in_subprocess(partial(divmod, 1, 0), LONG_S)


def test_prints_of_a_library_do_not_mix_with_the_result() -> None:
    assert call_in_subprocess(partial(os.write, 1, b"noise"), LONG_S) == 5


def test_the_file_that_was_really_loaded_is_named() -> None:
    (library,) = call_in_subprocess(partial(load_libraries, ["libc.so.6"]), LONG_S)
    assert os.path.basename(library.file).startswith("libc.so")  # noqa: PTH119 (the name alone)
    assert library.error == ""


def test_a_missing_library_is_reported() -> None:
    (library,) = call_in_subprocess(partial(load_libraries, ["libnosuch.so.1"]), LONG_S)
    assert library.file == ""
    assert "libnosuch.so.1" in library.error
