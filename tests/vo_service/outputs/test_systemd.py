"""Messages to systemd, received on a fake notify socket."""

import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.vo_service.fakes import make_status
from vo_service.outputs.systemd import SystemdNotifier, SystemdOutput
from vo_service.types.messages import LatencyReport
from vo_service.types.odometry_update import TrackingState

STATUS = make_status()


class NotifySocket:
    """Socket at NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.settimeout(5.0)

    def receive(self) -> list[str]:
        """Receive the lines of the next message."""
        return self.socket.recv(65536).decode().split("\n")

    def is_empty(self) -> bool:
        """Return whether no message is pending."""
        self.socket.setblocking(False)
        try:
            self.socket.recv(65536)
        except BlockingIOError:
            return True
        return False


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NotifySocket]:
    """A notify socket at a path."""
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    listener = NotifySocket(address)
    yield listener
    listener.socket.close()


def test_the_first_status_sends_ready_and_each_triggers_the_watchdog(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    output.on_status(STATUS)
    output.on_status(STATUS)
    assert systemd.receive() == ["READY=1", "WATCHDOG=1", "STATUS=tracking; 30 poses/s"]
    assert systemd.receive() == ["WATCHDOG=1", "STATUS=tracking; 30 poses/s"]
    output.close()


def test_the_status_line_has_reason_and_warnings(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    state, reason = TrackingState.NO_CAMERA, "freenect: no Kinect\nis plugged in"
    output.on_status(
        replace(
            STATUS, state=state, reason=reason, latency=LatencyReport(), warnings=("disk full",)
        )
    )
    expected = "STATUS=no_camera: freenect: no Kinect is plugged in; 0 poses/s; disk full"
    assert systemd.receive()[-1] == expected
    output.close()


def test_a_status_line_is_one_line_of_limited_length(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    output.on_status(replace(STATUS, paused=True, warnings=("words\r\nand words",) * 1000))
    lines = systemd.receive()
    assert len(lines) == 3
    assert "; paused; " in lines[-1]
    assert len(lines[-1]) < 600
    output.close()


def test_a_reload_is_reported_from_start_to_end(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    with output.notify_reloading():
        begin = systemd.receive()
    assert begin[0] == "RELOADING=1"
    assert begin[1].removeprefix("MONOTONIC_USEC=").isdigit()
    assert systemd.receive() == ["READY=1"]
    output.close()


def test_stopping_is_sent_once_and_closing_twice_is_safe(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    output.close()
    output.close()
    output.on_status(STATUS)
    assert systemd.receive() == ["STOPPING=1", "STATUS=stopping"]
    assert systemd.is_empty()


def test_an_abstract_socket_is_supported(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"kinect-vo-test-{threading.get_native_id()}"
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    listener = NotifySocket(f"\0{name}")
    notifier = SystemdNotifier()
    assert notifier.send("READY=1")
    assert listener.receive() == ["READY=1"]
    notifier.close()
    listener.socket.close()


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    output = SystemdOutput()
    output.on_status(STATUS)
    with output.notify_reloading():
        pass
    output.close()


def test_a_missing_or_blocked_systemd_blocks_nothing(systemd: NotifySocket) -> None:
    output = SystemdOutput()
    for _ in range(2000):  # more than a socket's buffer holds: a blocking one would stop here
        output.on_status(STATUS)
    systemd.socket.close()
    output.on_status(STATUS)
    output.close()


def test_ready_is_repeated_until_it_was_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = str(tmp_path / "late")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    output = SystemdOutput()
    output.on_status(STATUS)
    listener = NotifySocket(address)
    output.on_status(STATUS)
    assert listener.receive()[0] == "READY=1"
    output.close()
    listener.socket.close()
