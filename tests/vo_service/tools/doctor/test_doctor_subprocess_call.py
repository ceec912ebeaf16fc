"""Functions that are called in a subprocess."""

import ctypes
import os
import time
from collections.abc import Callable
from functools import partial

import pytest

from drivers.core import UserFacingError
from vo_service.tools.doctor.library_checks import load_libraries
from vo_service.tools.doctor.stream_probe import call_in_subprocess

pytestmark = pytest.mark.subprocess

LONG_S = 100.0


def test_the_result_of_another_process_comes_back_without_its_prints() -> None:
    assert call_in_subprocess(os.getppid, LONG_S) == os.getpid()
    assert call_in_subprocess(partial(os.write, 1, b"noise"), LONG_S) == 5


@pytest.mark.parametrize(
    ("function", "timeout_s", "message"),
    [
        (partial(ctypes.string_at, 0), LONG_S, "crashed with SIGSEGV"),
        (partial(time.sleep, 600), 0.5, r"no answer within 0\.5 s"),
        (partial(divmod, 1, 0), LONG_S, "failed: ZeroDivisionError"),
    ],
    ids=["crash", "hang", "error"],
)
def test_a_crash_a_hang_and_an_error_are_named(
    function: Callable[[], object], timeout_s: float, message: str
) -> None:
    with pytest.raises(UserFacingError, match=message):
        call_in_subprocess(function, timeout_s)


def test_the_file_that_was_really_loaded_is_named_and_a_missing_one_is_reported() -> None:
    names = ["libc.so.6", "libnosuch.so.1"]
    loaded, missing = call_in_subprocess(partial(load_libraries, names), LONG_S)
    assert os.path.basename(loaded.file).startswith("libc.so")  # noqa: PTH119 (the name alone)
    assert (loaded.error, missing.file) == ("", "")
    assert "libnosuch.so.1" in missing.error
