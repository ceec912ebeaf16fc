"""kinect-vo as a user runs it: in a process of its own, or (much quicker) within this one."""

import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests import forked_process
from tests.vo_service.service_process import KINECT_VO_WITH_LONG_TIMEOUT
from vo_service.cli import command_line


@dataclass(frozen=True)
class CommandResult:
    """What a user sees of a command."""

    code: int | str | None
    out: str
    err: str

    @property
    def error_lines(self) -> str:
        """What stderr has beside lines that only inform."""
        lines = self.err.splitlines(keepends=True)
        return "".join(line for line in lines if not line.startswith("kinect-vo: info: "))


KinectVo = Callable[..., CommandResult]


def run_in_process(capfd: pytest.CaptureFixture[str], *arguments: object) -> CommandResult:
    """Run a command in this process; what native libraries print counts too."""
    capfd.readouterr()
    with pytest.raises(SystemExit) as caught:
        command_line.main([str(argument) for argument in arguments])
    captured = capfd.readouterr()
    return CommandResult(caught.value.code, captured.out, captured.err)


def run_subprocess(*arguments: object) -> CommandResult:
    """Run a command in a process of its own."""
    done = forked_process.run(
        [*forked_process.KINECT_VO, *(str(argument) for argument in arguments)]
    )
    return CommandResult(done.returncode, done.stdout, done.stderr)


@contextmanager
def running_subprocess(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A command that is still going; killed at the end of the block."""
    command = [*KINECT_VO_WITH_LONG_TIMEOUT, *(str(argument) for argument in arguments)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with forked_process.ForkedProcess(command, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


def assert_one_line(outcome: CommandResult, code: int, message: str) -> None:
    """Check that a command failed with one line, which has this message."""
    *notes, error = outcome.err.splitlines()
    assert (outcome.code, outcome.out) == (code, "")
    assert all(note.startswith("kinect-vo: info: ") for note in notes)  # on a slow machine
    assert error.startswith("kinect-vo: error: ")
    assert message in error


def documented_json_keys() -> set[str]:
    """Keys of the objects of `--json` in the tables of docs/reference/errors.md."""
    page = (Path(__file__).parents[3] / "docs/reference/errors.md").read_text()
    rows = re.findall(r"^\| (`\w+`.*?) \|", page.split("## JSON output")[1].split("## ")[0], re.M)
    return set(re.findall(r"`(\w+)`", " ".join(rows)))


def count_lines(path: Path) -> int:
    """Whole lines of a file that may not be there yet."""
    return path.read_bytes().count(b"\n") if path.exists() else 0


def stretch_timing(folder: Path, period_s: float) -> Path:
    """The same frames, so long apart."""
    for name in ("rgb.txt", "depth.txt"):
        words = [line.split() for line in (folder / name).read_text().splitlines()[1:]]
        lines = [f"{k * period_s:.6f} {file}\n" for k, (_, file) in enumerate(words)]
        (folder / name).write_text("".join(lines))
    return folder
