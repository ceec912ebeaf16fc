"""Functions in a process of their own."""

import ctypes
import os
import time
from functools import partial

import pytest

from drivers.errors import UserFacingError
from vo_service.doctor.child import in_child
from vo_service.doctor.loaded import load

pytestmark = pytest.mark.subprocess

PLENTY_S = 100.0


def test_the_result_comes_back() -> None:
    assert in_child(partial(divmod, 17, 5), PLENTY_S) == (3, 2)


def test_it_is_another_process() -> None:
    assert in_child(os.getppid, PLENTY_S) == os.getpid()


def test_a_crash_is_named() -> None:
    with pytest.raises(UserFacingError, match="crashed with SIGSEGV"):
        in_child(partial(ctypes.string_at, 0), PLENTY_S)


def test_a_hang_is_ended() -> None:
    with pytest.raises(UserFacingError, match=r"no answer within 0\.5 s"):
        in_child(partial(time.sleep, 600), 0.5)


def test_an_error_is_told_in_one_line() -> None:
    with pytest.raises(UserFacingError, match="failed: ZeroDivisionError"):
        in_child(partial(divmod, 1, 0), PLENTY_S)


def test_what_a_library_prints_is_not_taken_for_the_answer() -> None:
    assert in_child(partial(os.write, 1, b"noise"), PLENTY_S) == 5


def test_the_file_that_was_really_loaded_is_named() -> None:
    (found,) = in_child(partial(load, ["libc.so.6"]), PLENTY_S)
    assert os.path.basename(found.file).startswith("libc.so")  # noqa: PTH119 (the name alone)
    assert found.error == ""


def test_a_library_that_is_not_there_is_said() -> None:
    (found,) = in_child(partial(load, ["libnosuch.so.1"]), PLENTY_S)
    assert found.file == ""
    assert "libnosuch.so.1" in found.error
