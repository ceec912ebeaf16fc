"""External Rerun viewers that start, freeze and exit."""

import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest

from tests.resource_leaks import child_pids, resident_memory_kb
from tests.waiting import wait_until
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.output import RerunOutput, open_rerun_output
from vo_service.outputs.rerun.viewer_probe import GrpcViewerProbe, ViewerHealthMonitor
from vo_service.outputs.rerun.web_viewer_server import rerun_binary
from vo_service.types import OdometryUpdate

MakeUpdate = Callable[..., OdometryUpdate]
ABSENT = "no viewer answers at"


@contextmanager
def closing_probe(port: int) -> Iterator[GrpcViewerProbe]:
    """Make a probe and close it at the end."""
    probe = GrpcViewerProbe("127.0.0.1", port)
    yield probe
    probe.disconnect()


@contextmanager
def viewer(port: int) -> Iterator["subprocess.Popen[bytes]"]:
    """Run Rerun's own server, which a viewer contains."""
    command = [str(rerun_binary()), "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            with closing_probe(port) as probe:
                wait_until(probe.connect)
            yield process
        finally:
            process.kill()


@pytest.fixture
def output(free_port: int) -> Iterator[RerunOutput]:
    """An output to a viewer at the free port."""
    output = open_rerun_output(f"connect:127.0.0.1:{free_port}", RerunConfig(memory_mb=400))
    yield output
    output.close()


def processes() -> list[int]:
    """List the processes that draw; one that is still starting has little memory."""
    return [pid for pid in child_pids() if resident_of(pid) > 50_000]


def test_a_missing_viewer_needs_no_process(
    output: RerunOutput, make_update: MakeUpdate, caplog: pytest.LogCaptureFixture
) -> None:
    for seq in range(30):
        output.on_update(make_update(seq))
    assert ABSENT in output.warning
    assert child_pids() == []
    logged = [record.message for record in caplog.get_records("setup") + caplog.records]
    assert sum(ABSENT in message for message in logged) == 1


@pytest.mark.subprocess
def test_a_viewer_that_starts_late_ends_and_restarts_receives_data(
    free_port: int, output: RerunOutput, make_update: MakeUpdate
) -> None:
    output.on_update(make_update(0))
    for _ in range(2):
        assert ABSENT in output.warning
        with viewer(free_port):
            wait_until(lambda: output.warning == "")
            output.on_update(make_update(30))
            assert len(processes()) >= 1
        wait_until(lambda: ABSENT in output.warning)


@pytest.mark.subprocess
def test_a_frozen_viewer_is_disconnected_and_memory_stays_bounded(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = make_update(0)
    noise = np.random.default_rng(0).integers(0, 255, (960, 1280, 3), np.uint8)
    update = replace(update, frame=replace(update.frame, color_bgr=noise))
    settings = RerunConfig(memory_mb=400, picture_hz=1000.0)
    with viewer(free_port) as frozen:
        output = open_rerun_output(f"connect:127.0.0.1:{free_port}", settings)
        wait_until(lambda: output.warning == "")
        (process,) = set(child_pids()) - {frozen.pid}
        frozen.send_signal(signal.SIGSTOP)
        sizes_kb, durations_s = [0], [0.0]

        def is_given_up() -> bool:
            start_s = time.monotonic()
            output.on_update(update)
            durations_s.append(time.monotonic() - start_s)
            sizes_kb.append(resident_of(process))
            return ABSENT in output.warning or "memory_mb" in output.warning

        wait_until(is_given_up)
        output.close()
    assert max(durations_s) < 10.0
    assert max(sizes_kb) < 600_000


def resident_of(process: int) -> int:
    """Return the memory of a process in kB; 0 if it has ended."""
    try:
        return resident_memory_kb(process)
    except (OSError, AssertionError):
        return 0


def test_a_server_that_never_replies_is_no_viewer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert not GrpcViewerProbe(*server.getsockname()).connect()


def test_a_server_with_another_protocol_is_no_viewer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with server.accept()[0] as connection:
                connection.sendall(b"HTTP/1.1 505 no\r\n\r\n")

        threading.Thread(target=answer).start()
        assert not GrpcViewerProbe(*server.getsockname()).connect()


@pytest.mark.slow
def test_a_server_that_sends_endlessly_is_no_viewer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        has_ended = threading.Event()

        def send_forever() -> None:
            with server.accept()[0] as connection, suppress(OSError):
                while not has_ended.is_set():
                    connection.sendall(b"\0\0\0\x08" + bytes(5))

        thread = threading.Thread(target=send_forever)
        thread.start()
        probe = GrpcViewerProbe(*server.getsockname())
        assert not probe.connect()
        has_ended.set()
        thread.join()


def test_a_server_that_sends_an_invalid_frame_is_disconnected_at_once() -> None:
    settings, too_large = b"\0\0\0\x04" + bytes(5), b"\0\x40\x01\x08" + bytes(5)
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        closing_probe(server.getsockname()[1]) as probe,
        ThreadPoolExecutor(1) as pool,
    ):
        connected = pool.submit(probe.connect)
        with server.accept()[0] as connection:
            connection.sendall(settings + too_large)
            assert connected.result()
            with pytest.raises(ConnectionError):
                probe.is_responding()


@pytest.mark.subprocess
def test_a_replaced_viewer_is_noticed_at_once(free_port: int) -> None:
    with closing_probe(free_port) as probe:
        with viewer(free_port):
            assert probe.connect()
            assert probe.is_responding()
        with viewer(free_port), pytest.raises(ConnectionError):
            probe.is_responding()


class ScriptedProbe:
    """Probe with scripted replies."""

    def __init__(self, *answers: bool | Exception) -> None:
        self._answers = list(answers)

    def connect(self) -> bool:
        """Return True."""
        return True

    def is_responding(self) -> bool:
        """Return or raise the next reply."""
        answer = self._answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def disconnect(self) -> None:
        """Do nothing."""


def test_a_slow_viewer_gets_a_second_chance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("vo_service.outputs.rerun.viewer_probe.PROBE_PERIOD_S", 0.0)
    monitor = ViewerHealthMonitor(
        ScriptedProbe(True, False, False, True, False, False, False, ConnectionError())
    )
    assert monitor.connect()
    assert [monitor.has_gone() for _ in range(8)] == [False] * 6 + [True, True]
