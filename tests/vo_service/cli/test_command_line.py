"""The command line as a whole: help, version, exit codes, logging."""

import errno
import logging
import os
import signal
import subprocess
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.service_process import KINECT_VO
from vo_service.cli import command_line, warm_up
from vo_service.cli.command_line import COMMANDS
from vo_service.signals import InterruptedBySignal


def test_help_names_every_command_with_examples_and_exit_codes(kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("--help")
    assert (outcome.code, outcome.err) == (0, "")
    for word in (*COMMANDS, "examples:", "exit codes:"):
        assert word in outcome.out


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help_with_an_example(command: str, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo(command, "--help")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert f"examples:\n  kinect-vo {command}" in outcome.out


def test_the_version_is_the_packages(kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("--version")
    assert (outcome.code, outcome.out) == (0, f"kinect-vo {version('kinect-vo')}\n")


def test_two_calls_in_one_process_print_everything_once(kinect_vo: KinectVo) -> None:
    for _ in range(2):
        outcome = kinect_vo("replay", "none", "--no-publish")
        assert outcome.err == "kinect-vo: error: none: no such folder; check the path\n"


def test_a_call_restores_the_log(kinect_vo: KinectVo) -> None:
    root = logging.getLogger()
    before = (root.level, list(root.handlers))
    kinect_vo("config", "check", "none.toml", "--verbose")
    assert (root.level, list(root.handlers)) == before


def test_a_call_restores_the_signal_handlers(recording: Path, kinect_vo: KinectVo) -> None:
    before = (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM))
    kinect_vo("replay", recording, "--no-publish")
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.mark.zenoh
def test_a_valid_configuration_is_reported_as_valid(config: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("config", "check", config)
    assert (outcome.code, outcome.out, outcome.err) == (0, f"{config}: no mistakes\n", "")


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The parts that warm-up asks for, in place of their compilation."""
    parts: list[str] = []
    monkeypatch.setattr(warm_up, "compile_kernels", lambda asked, *_: parts.extend(asked))
    return parts


def test_warm_up_compiles_the_method_and_maps_and_reports_its_end(
    kinect_vo: KinectVo, compiled: list[str]
) -> None:
    outcome = kinect_vo("warm-up")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert {"direct", "loop closure"} <= set(compiled)
    assert outcome.out.startswith("the kernels of direct and of maps are ready (")


def test_warm_up_compiles_no_loop_closure_without_a_map(
    tmp_path: Path, kinect_vo: KinectVo, compiled: list[str]
) -> None:
    config = tmp_path / "kinect.toml"
    config.write_text("schema = 1\n[map]\nenabled = false\n")
    outcome = kinect_vo("warm-up", "--config", config)
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert "loop closure" not in compiled
    assert " and of maps " not in outcome.out


def test_warm_up_with_first_compiles_only_what_the_first_pose_needs(
    kinect_vo: KinectVo, compiled: list[str]
) -> None:
    assert kinect_vo("warm-up", "--first").code == 0
    assert compiled == ["direct", "frame packing", "virtual Kinect"]


def test_warm_up_for_an_unknown_processor_is_one_line(kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("warm-up", "--for", "pentium-9")
    assert_one_line(outcome, 2, "--for pentium-9: no processor of this architecture")


def test_warm_up_for_a_processor_compiles_into_the_environment(
    tmp_path: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_CACHE_DIR", "CACHE_DIRECTORY"):
        monkeypatch.setenv(name, "")  # and restored afterwards
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    monkeypatch.setattr(warm_up, "is_known", lambda _name: True)
    folder = tmp_path / "share" / "kinect-vo" / "kernels"
    noted_before = []
    monkeypatch.setattr(
        warm_up, "compile_kernels", lambda *_: noted_before.append((folder / "processor").exists())
    )
    assert kinect_vo("warm-up", "--for", "cortex-a72").code == 0
    assert noted_before == [False]
    assert (folder / "processor").read_text() == "cortex-a72\n"
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == folder
    assert (os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"]) == ("cortex-a72", "")


@pytest.mark.subprocess
def test_a_closed_reader_is_no_error() -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run(
        [KINECT_VO, "udev", "show"],
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        stdout=theirs, stderr=subprocess.PIPE, text=True, timeout=100, check=False,
    )  # fmt: skip
    os.close(theirs)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.subprocess
@pytest.mark.parametrize("arguments", [("udev", "show"), ("--help",)])
def test_a_full_disk_under_standard_output_is_one_line(arguments: tuple[str, ...]) -> None:
    done = _in_shell("exec >/dev/full", *arguments)
    assert done.returncode == 1
    assert done.stderr.startswith("kinect-vo: error: standard output: No space left on device")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device; fix this"),
        (OSError(errno.EIO, "I/O error", "a.txt"), "a.txt: I/O error; fix this and run again"),
        (OSError("a text"), "a text; fix this and run again"),
    ],
)
def test_only_an_error_of_standard_output_is_said_to_be_one(
    error: OSError, message: str, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(args: object) -> int:
        raise error

    monkeypatch.setattr("vo_service.cli.udev.run", fail)
    with monkeypatch.context() as patch:
        patch.setattr(
            command_line, "_discard_buffered_output", lambda: None
        )  # else nothing is captured
        outcome = kinect_vo("udev", "show")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith(f"kinect-vo: error: {message}")


@pytest.mark.subprocess
def test_a_path_that_the_terminal_cannot_show_is_escaped(recording: Path, tmp_path: Path) -> None:
    target = tmp_path / "\xe9.mcap"
    done = subprocess.run(
        [KINECT_VO, "convert", recording, target],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 0
    assert rb"\xe9.mcap (mcap)" in done.stdout
    assert target.exists()


@pytest.mark.subprocess
def test_a_removed_current_folder_is_named(tmp_path: Path) -> None:
    arguments = ("replay", "/", "--no-publish", "--trajectory", "poses.txt")
    done = _in_shell(f"cd {tmp_path} && rmdir {tmp_path}", *arguments)
    expected = "the current folder: No such file or directory; fix this and run again"
    assert (done.returncode, done.stderr) == (1, f"kinect-vo: error: {expected}\n")


@pytest.mark.subprocess
@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_without_standard_streams_it_does_the_same(closed: str) -> None:
    done = _in_shell(f"exec {closed}", "udev", "show")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_missing_cache_folder_is_one_line(
    tmp_path: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_the_way = tmp_path / f"kinect-vo-{os.getuid()}"
    in_the_way.touch()
    monkeypatch.setenv("HOME", str(in_the_way))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("NUMBA_CACHE_DIR", "CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert_one_line(kinect_vo("config", "check", "none.toml"), 1, "error: no folder is writable")


def _in_shell(first: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """A command in a shell that begins with `first`, which changes its streams."""
    words = [KINECT_VO, *(str(argument) for argument in arguments)]
    return subprocess.run(
        ["sh", "-c", f'{first}; exec "$@"', "sh", *words],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip


def test_a_log_line_replaces_the_progress(
    copy_recording: Callable[..., Path], kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    recording = copy_recording()
    max((recording / "depth").iterdir()).write_bytes(b"")
    outcome = kinect_vo("replay", recording, "--no-publish")
    warnings = [line for line in outcome.err.split("\r\x1b[K") if "is skipped" in line]
    assert warnings
    assert all(line.startswith("kinect-vo: warning: ") for line in warnings)
    assert outcome.err.endswith("\r\x1b[K")


@pytest.mark.parametrize(
    ("interruption", "code"), [(KeyboardInterrupt(), 130), (InterruptedBySignal(143), 143)]
)
def test_a_signal_during_the_start_prints_no_traceback(
    interruption: KeyboardInterrupt, code: int, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(name: str) -> None:
        raise interruption

    monkeypatch.setattr("importlib.import_module", interrupt)
    outcome = kinect_vo("replay", "room")
    assert (outcome.code, outcome.out, outcome.err) == (code, "", "")


@pytest.mark.parametrize("arguments", [("replay", "a\nb\x1bc"), ("replay", "a\nb\x1bc", "--x"),
                                       ("replay", ".", "--pace", "a\nb\x1bc")])  # fmt: skip
def test_an_error_is_one_line_whatever_a_name_holds(
    arguments: tuple[str, ...], kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo(*arguments)
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert "\x1b" not in outcome.err
