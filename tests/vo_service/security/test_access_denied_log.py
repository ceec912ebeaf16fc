"""The router's log of denied access, with the real Zenoh in a process."""

import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests import forked_process
from tests.vo_service.security.tls_network import HOST, TlsNetwork, can_connect, query_replies
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


def test_refused_clients_are_logged_with_the_reason(network: TlsNetwork) -> None:
    ours = network.folder / "ours/reader"
    (network.folder / "strange/operator/ca.pem").write_bytes((ours / "ca.pem").read_bytes())
    with running_router(network) as router:
        for payload in (b"GET / HTTP/1.0\r\n\r\n", b""):
            with socket.create_connection((HOST, network.tls_port)) as client:
                client.sendall(payload)
        for identity in ("strange/operator", "ours/late"):
            assert not can_connect(network.file("reader-tls.json5", identity))
        router.wait_for_line("refused a connection: it does not speak TLS")
        router.wait_for_line("refused a connection: it disconnected during the handshake")
        router.wait_for_line("refused a connection: its certificate is from an unknown authority")
        router.wait_for_line("refused a connection: its certificate has expired")
        assert "Hint" not in router.log
        assert "TRACE" not in router.log


def test_a_client_without_a_rule_is_logged_with_its_request(network: TlsNetwork) -> None:
    with running_router(network) as router:
        with network.open_session("reader-tls.json5", "ours/reader") as reader:
            reader.declare_subscriber("*/odom", lambda sample: None)
            assert query_replies(reader, "robot1/command/reset") == []
            reader.put("robot1/odom", b"forged")
        router.wait_for_line('denied "reader": query on robot1/command/reset')
        router.wait_for_line('denied "reader": put on robot1/odom')
        denied = re.findall(r"denied.*", router.log)
    assert len(denied) == 2  # what it may do is not complained of


def test_a_flood_gives_a_few_lines(network: TlsNetwork) -> None:
    with running_router(network) as router:
        with network.open_session("reader-tls.json5", "ours/reader") as reader:
            for number in range(3000):
                reader.put(f"robot1/odom/{number % 300}", b"forged")
        router.wait_for_line("denied")
        router.process.send_signal(signal.SIGTERM)
        assert router.process.wait(100) == 0
    assert len(router.log.splitlines()) < 12
    assert "Unable to write" not in router.log


def test_connections_are_logged_on_request(network: TlsNetwork) -> None:
    with running_router(network, "--verbose") as router:
        network.open_session("reader-tls.json5", "ours/reader").close()  # type: ignore[no-untyped-call]
        router.wait_for_line("disconnected")
    assert re.search(r"zenoh: reader, tls/127\.0\.0\.1:\d+: connected", router.log)


def test_a_file_of_another_program_is_rejected(network: TlsNetwork) -> None:
    file = network.file("fleet-robot.json5", "ours/robot1")
    done = forked_process.run([*forked_process.KINECT_VO, "router", str(file)])
    assert done.returncode == 2
    assert 'set mode: "router"' in done.stderr
