"""A Zenoh router in a separate process, like `zenohd` on a real network.

    python -m tests.simulators.zenoh_router ENDPOINT

It runs until its standard input is closed.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh


class RouterProcess:
    """A router that can be killed and started again at the same endpoint."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._process = self._start_process()

    def kill(self) -> None:
        """Kill the router by SIGKILL."""
        with self._process:  # closes the pipe and waits for the process
            self._process.kill()

    def start(self) -> None:
        """Start the router again after `kill`."""
        self._process = self._start_process()

    def _start_process(self) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "tests.simulators.zenoh_router", self.endpoint]
        return subprocess.Popen(command, stdin=subprocess.PIPE)


@contextmanager
def running_router(endpoint: str) -> Iterator[RouterProcess]:
    """Run a router; kill it at the end."""
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
