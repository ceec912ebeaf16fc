"""A process that takes part in a benchmark, and talks to it through pipes."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class PipedProcess(subprocess.Popen[str]):
    """A running process that prints "ready", and reads a line for each command."""

    def wait_until_ready(self) -> None:
        """Wait until it is ready. Raises RuntimeError if it ends before."""
        assert self.stdout is not None
        if self.stdout.readline() != "ready\n":
            raise RuntimeError(f"{self.args!r} has failed")

    def send(self, command: str) -> None:
        """Send it a command."""
        assert self.stdin is not None
        self.stdin.write(f"{command}\n")
        self.stdin.flush()

    def end(self) -> Any:
        """Send it "end"; return its result, a line of JSON."""
        self.send("end")
        assert self.stdout is not None
        return json.loads(self.stdout.readline())


@contextmanager
def running_process(*command: str | Path) -> Iterator[PipedProcess]:
    """Run a process; kill it at the end."""
    pipe = subprocess.PIPE
    with PipedProcess(command, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def print_ready() -> None:
    """Tell the benchmark that this process is ready."""
    print("ready", flush=True)
