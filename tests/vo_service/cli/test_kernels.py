"""What comes before the loop: the kernels."""

import errno
import signal
from collections.abc import Callable
from pathlib import Path

import numba
import pytest

from drivers.core import UserFacingError
from vo_service.cli import kernels
from vo_service.cli.kernels import loops_are_prepared, prepare_kernels, prepare_loop_closure
from vo_service.config import Config
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.slam import synchronous_loop_closure
from vo_service.terminal import Terminal


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_compilation_stops_after_the_current_kernel(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    double = numba.njit(lambda x: 2 * x)

    def compile_one(method: str, tell: Callable[[str], None]) -> float:
        signal.raise_signal(number)
        return float(double(1))

    monkeypatch.setattr(kernels, "warm_up", compile_one)
    with stop_on_signals() as stop, pytest.raises(KeyboardInterrupt):
        prepare_kernels(Config(), Terminal(), stop)
    assert double.signatures == []


def test_preparation_of_loop_closure_stops_like_that_of_the_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    def interrupted(tell: Callable[[str], None]) -> float:
        calls.append("begun")
        signal.raise_signal(signal.SIGINT)
        return 1.0

    monkeypatch.setattr(synchronous_loop_closure, "warm_up_loop_closure", interrupted)
    with stop_on_signals() as stop, pytest.raises(KeyboardInterrupt):
        prepare_loop_closure(Terminal(), stop)
    assert calls == ["begun"]


def test_finished_preparation_of_loop_closure_is_remembered(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(kernels, "kernel_folder", lambda: tmp_path)
    monkeypatch.setattr(synchronous_loop_closure, "warm_up_loop_closure", lambda tell: 1.0)
    assert not loops_are_prepared()
    prepare_loop_closure(Terminal(), StopSignal())
    assert loops_are_prepared()


def test_kernels_without_disk_space_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(method: str, tell: Callable[[str], None]) -> float:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(kernels, "warm_up", fill)
    with pytest.raises(UserFacingError, match="cannot be written: No space left on device; free"):
        prepare_kernels(Config(), Terminal(), StopSignal())
