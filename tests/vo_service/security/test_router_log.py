"""The router's log of connections, with the real Zenoh in a process."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests import forked_process
from tests.vo_service.security.tls_network import TlsNetwork
from tests.waiting import wait_until

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]


class RunningRouter:
    def __init__(self, process: "subprocess.Popen[bytes]", log: Path) -> None:
        self.process, self._log = process, log

    @property
    def log(self) -> str:
        return self._log.read_text()

    def wait_for_line(self, text: str) -> None:
        wait_until(lambda: text in self.log, f"{text!r}")


@contextmanager
def running_router(network: TlsNetwork, *options: str) -> Iterator[RunningRouter]:
    file, log = (
        network.file("fleet-router.json5", network.server_identity),
        network.folder / "log.txt",
    )
    with log.open("wb") as output:
        command = [*forked_process.KINECT_VO, "router", str(file), *options]
        process = forked_process.ForkedProcess(command, stdout=output, stderr=output)
    try:
        router = RunningRouter(process, log)
        router.wait_for_line("listening at")
        yield router
    finally:
        process.kill()
        process.wait()


def test_connections_are_logged_on_request(network: TlsNetwork) -> None:
    with running_router(network, "--verbose") as router:
        network.open_session("reader-tls.json5", "ours/reader").close()  # type: ignore[no-untyped-call]
        router.wait_for_line("disconnected")
    changes = re.findall(r"zenoh: reader, tls/127\.0\.0\.1:\d+: (\w+)", router.log)
    assert changes == ["connected", "disconnected"]


def test_a_file_of_another_program_is_rejected(network: TlsNetwork) -> None:
    file = network.file("fleet-robot.json5", "ours/robot1")
    done = forked_process.run([*forked_process.KINECT_VO, "router", str(file)])
    assert done.returncode == 2
    assert 'set mode: "router"' in done.stderr
