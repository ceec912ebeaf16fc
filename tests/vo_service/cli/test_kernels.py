"""What comes before the loop: the kernels."""

import errno
import signal
from collections.abc import Callable, Sequence

import numba
import pytest

from drivers.core import UserFacingError
from vo_service.cli import kernels
from vo_service.cli.kernels import compile_kernels, first_parts, prepare_kernels, run_warm_up
from vo_service.config import Config
from vo_service.config_tables import ScanConfig
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_compilation_in_this_process_stops_after_the_current_kernel(number: signal.Signals) -> None:
    double = numba.njit(lambda x: 2 * x)

    def compile_one(_report: Callable[[str], None]) -> float:
        signal.raise_signal(number)
        return float(double(1))

    with stop_on_signals() as stop, pytest.raises(KeyboardInterrupt):
        run_warm_up(compile_one, Terminal(), stop)
    assert double.signatures == []


def test_compilation_in_other_processes_stops_at_the_next_progress(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(_parts: Sequence[str], report: Callable[[str], None]) -> None:
        signal.raise_signal(signal.SIGINT)
        report("1 of 2")
        pytest.fail("it goes on")

    monkeypatch.setattr(kernels, "ensure_compiled", interrupted)
    with stop_on_signals() as stop, pytest.raises(KeyboardInterrupt):
        compile_kernels(["direct"], Terminal(), stop)


def test_kernels_without_disk_space_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(_parts: Sequence[str], _report: Callable[[str], None]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(kernels, "ensure_compiled", fill)
    with pytest.raises(UserFacingError, match="cannot be written: No space left on device; free"):
        prepare_kernels(Config(), Terminal(), StopSignal())


def test_a_plug_in_is_run_on_generated_frames_before_the_first_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run: list[str] = []
    monkeypatch.setattr(kernels, "METHODS", {"direct": None, "mine": None})
    monkeypatch.setattr(kernels, "warm_up", lambda method, _report: run.append(method))
    monkeypatch.setattr(kernels, "ensure_compiled", lambda _parts, _report: None)
    compile_kernels(["direct"], Terminal(), StopSignal())
    compile_kernels(["mine"], Terminal(), StopSignal())
    assert run == ["mine"]


@pytest.mark.parametrize(
    ("source", "part"), [("freenect", ["Kinect"]), ("synthetic", ["virtual Kinect"]), ("tum:x", [])]
)
def test_the_first_pose_needs_the_kernels_of_its_camera(source: str, part: list[str]) -> None:
    assert first_parts(Config(), source) == ["direct", "frame packing", *part]


def test_a_scan_of_each_frame_has_its_kernels_compiled_with_progress() -> None:
    config = Config(scan=ScanConfig(enabled=True))
    assert first_parts(config, "tum:x") == ["direct", "frame packing", "scan"]
