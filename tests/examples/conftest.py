"""A real `kinect-vo run`, on a recording that goes on for minutes."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from itertools import chain, cycle, islice
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import FRAMES
from tests.forked_process import ForkedProcess
from tests.vo_service.client.fake_service import find_free_endpoint
from tests.vo_service.service_process import KINECT_VO_WITH_LONG_TIMEOUT, NO_MAP_CONFIG
from vo_service import PoseClient

EXAMPLES = Path(__file__).parents[2] / "examples"
# Slow, so that the service leaves the processors to the examples.
RATE_HZ = 5
DURATION_S = 300


@pytest.fixture(scope="session")
def long_recording(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short recording there and back, again and again, without a copy of an image."""
    folder = tmp_path_factory.mktemp("long")
    for part in ("rgb", "depth", "camera.toml"):
        (folder / part).symlink_to(recording / part)
    for part in ("rgb", "depth"):
        lines = (recording / f"{part}.txt").read_text().splitlines()
        files = [line.split()[1] for line in lines if not line.startswith("#")]
        there_and_back = chain(range(FRAMES), range(FRAMES - 2, 0, -1))
        played = islice(cycle(there_and_back), RATE_HZ * DURATION_S)
        rows = [f"{i / RATE_HZ:.6f} {files[k]}\n" for i, k in enumerate(played)]
        (folder / f"{part}.txt").write_text("".join(rows))
    return folder


@pytest.fixture(scope="module")
def endpoint(long_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where the service is, once it publishes poses."""
    where, folder = find_free_endpoint(), tmp_path_factory.mktemp("run")
    config, log = folder / "kinect.toml", folder / "log.txt"
    config.write_text(
        f'schema = 1\n[zenoh]\nlisten = ["{where}"]\n[recorder]\nfolder = "{folder}/incidents"\n'
        f"{NO_MAP_CONFIG}"
    )
    command = [
        *KINECT_VO_WITH_LONG_TIMEOUT,
        "run",
        "--camera",
        f"tum:{long_recording}",
        "--config",
        str(config),
    ]
    surroundings = os.environ | {"XDG_STATE_HOME": str(folder), "STATE_DIRECTORY": str(folder)}
    with log.open("wb") as output:
        process = ForkedProcess(command, stdout=output, stderr=output, env=surroundings)
    try:
        with PoseClient(connect=where) as client:
            next(client.poses(timeout_s=110.0))  # kernels that nobody has compiled yet
        yield where
        process.terminate()
        assert process.wait(100) == 0, log.read_text()
    finally:
        process.kill()
        process.wait()


class ProgramOutput:
    """What a program prints, line by line; it is killed when that takes too long."""

    def __init__(self, process: "subprocess.Popen[str]", limit_s: float = 100.0) -> None:
        self._process = process
        self._timer = threading.Timer(limit_s, process.kill)
        self._timer.start()

    def wait_for_line(self, pattern: str) -> "re.Match[str]":
        """The first line that matches; fails if there is none."""
        seen: list[Any] = []
        assert self._process.stdout is not None
        for line in self._process.stdout:
            seen.append(line)
            if found := re.search(pattern, line):
                return found
        raise AssertionError(f"no line with {pattern!r}, but: {seen}")

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        self._process.send_signal(signal.SIGINT)

    def finish(self) -> tuple[str, int]:
        """What it still prints, and its exit code."""
        assert self._process.stdout is not None
        return self._process.stdout.read(), self._process.wait()

    def stop(self) -> None:
        """Enough."""
        self._timer.cancel()
        self._process.kill()
        self._process.communicate()


@contextmanager
def output_of(
    command: list[str], start: "type[subprocess.Popen[str]]" = subprocess.Popen
) -> Iterator[ProgramOutput]:
    """A program while it runs."""
    process = start(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    lines = ProgramOutput(process)
    try:
        yield lines
    finally:
        lines.stop()


def program(name: str, *arguments: object) -> AbstractContextManager[ProgramOutput]:
    """An example while it runs."""
    return output_of([sys.executable, str(EXAMPLES / name), *map(str, arguments)])
