"""kinect-vo as a user runs it: in a process of its own, or (much quicker) within this one."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests import preloaded
from tests.vo_service.played_service import PATIENT_KINECT_VO
from vo_service import cli


@dataclass(frozen=True)
class Outcome:
    """What a user sees of a command."""

    code: int | str | None
    out: str
    err: str

    @property
    def complaints(self) -> str:
        """What stderr has beside lines that only inform."""
        lines = self.err.splitlines(keepends=True)
        return "".join(line for line in lines if not line.startswith("kinect-vo: info: "))


def call(capfd: pytest.CaptureFixture[str], *arguments: object) -> Outcome:
    """Run a command in this process; what native libraries print counts too."""
    capfd.readouterr()
    with pytest.raises(SystemExit) as caught:
        cli.main([str(argument) for argument in arguments])
    said = capfd.readouterr()
    return Outcome(caught.value.code, said.out, said.err)


def run(*arguments: object) -> Outcome:
    """Run a command in a process of its own."""
    done = preloaded.run([*preloaded.KINECT_VO, *(str(argument) for argument in arguments)])
    return Outcome(done.returncode, done.stdout, done.stderr)


@contextmanager
def running(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A command that is still going; killed at the end of the block."""
    command = [*PATIENT_KINECT_VO, *(str(argument) for argument in arguments)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with preloaded.Preloaded(command, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


def line_count(path: Path) -> int:
    """Whole lines of a file that may not be there yet."""
    return path.read_bytes().count(b"\n") if path.exists() else 0


def stretched(folder: Path, period_s: float) -> Path:
    """The same frames, so long apart."""
    for name in ("rgb.txt", "depth.txt"):
        words = [line.split() for line in (folder / name).read_text().splitlines()[1:]]
        lines = [f"{k * period_s:.6f} {file}\n" for k, (_, file) in enumerate(words)]
        (folder / name).write_text("".join(lines))
    return folder
