"""A Zenoh router in a process of its own: what `zenohd` is on a real network.

    python -m tests.simulators.zenoh_router ENDPOINT

Runs until its standard input is closed.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh


class RouterProcess:
    """A router that can be killed and started again at the same place."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._process = self._start_process()

    def kill(self) -> None:
        """As `kill -9` does."""
        with self._process:  # closes the pipe, waits for the end
            self._process.kill()

    def start(self) -> None:
        """Once it has been killed."""
        self._process = self._start_process()

    def _start_process(self) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "tests.simulators.zenoh_router", self.endpoint]
        return subprocess.Popen(command, stdin=subprocess.PIPE)


@contextmanager
def running_router(endpoint: str) -> Iterator[RouterProcess]:
    """A router, killed at the end."""
    router = RouterProcess(endpoint)
    try:
        yield router
    finally:
        router.kill()


def main(endpoint: str) -> None:
    """Route until standard input is closed."""
    config = zenoh.Config()
    settings = {"mode": "router", "listen/endpoints": [endpoint]}
    for key, value in (settings | {"scouting/multicast/enabled": False}).items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1])
