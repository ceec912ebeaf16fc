"""Functions in a process of their own."""

import ctypes
import os
import time
from functools import partial

import pytest

from drivers.core.errors import UserFacingError
from vo_service.tools.doctor.library_info import load_libraries
from vo_service.tools.doctor.subprocess_call import call_in_subprocess

pytestmark = pytest.mark.subprocess

PLENTY_S = 100.0


def test_the_result_comes_back() -> None:
    assert call_in_subprocess(partial(divmod, 17, 5), PLENTY_S) == (3, 2)


def test_it_is_another_process() -> None:
    assert call_in_subprocess(os.getppid, PLENTY_S) == os.getpid()


def test_a_crash_is_named() -> None:
    with pytest.raises(UserFacingError, match="crashed with SIGSEGV"):
        call_in_subprocess(partial(ctypes.string_at, 0), PLENTY_S)


def test_a_hang_is_ended() -> None:
    with pytest.raises(UserFacingError, match=r"no answer within 0\.5 s"):
        call_in_subprocess(partial(time.sleep, 600), 0.5)


def test_an_error_is_told_in_one_line() -> None:
    with pytest.raises(UserFacingError, match="failed: ZeroDivisionError"):
        call_in_subprocess(partial(divmod, 1, 0), PLENTY_S)


def test_what_a_library_prints_is_not_taken_for_the_answer() -> None:
    assert call_in_subprocess(partial(os.write, 1, b"noise"), PLENTY_S) == 5


def test_the_file_that_was_really_loaded_is_named() -> None:
    (found,) = call_in_subprocess(partial(load_libraries, ["libc.so.6"]), PLENTY_S)
    assert os.path.basename(found.file).startswith("libc.so")  # noqa: PTH119 (the name alone)
    assert found.error == ""


def test_a_library_that_is_not_there_is_said() -> None:
    (found,) = call_in_subprocess(partial(load_libraries, ["libnosuch.so.1"]), PLENTY_S)
    assert found.file == ""
    assert "libnosuch.so.1" in found.error
