"""External Rerun viewers that start, freeze and exit."""

import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from tests.resource_leaks import child_pids, resident_memory_kb
from tests.vo_service.outputs.sample_updates import make_update
from tests.waiting import wait_until
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.output import RerunOutput, open_rerun_output
from vo_service.outputs.rerun.sinks import RunningViewerSink
from vo_service.outputs.rerun.web_viewer_server import rerun_binary

ABSENT, BLOCKED = "no viewer answers at", "does not read its data"
ADDRESS = "rerun+http://127.0.0.1:{}/proxy"


@contextmanager
def viewer(port: int) -> Iterator["subprocess.Popen[bytes]"]:
    """Run Rerun's own server, which a viewer contains."""
    command = [str(rerun_binary()), "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            wait_until(lambda: RunningViewerSink(ADDRESS.format(port)).is_present())
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
    output: RerunOutput, caplog: pytest.LogCaptureFixture
) -> None:
    for seq in range(30):
        output.on_update(make_update(seq))
    assert ABSENT in output.warning
    assert child_pids() == []
    logged = [record.message for record in caplog.get_records("setup") + caplog.records]
    assert sum(ABSENT in message for message in logged) == 1


@pytest.mark.subprocess
def test_a_viewer_that_starts_late_ends_and_restarts_receives_data(
    free_port: int, output: RerunOutput
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
def test_a_frozen_viewer_is_reported_and_memory_stays_bounded(free_port: int) -> None:
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
            return any(words in output.warning for words in (ABSENT, BLOCKED, "memory_mb"))

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


@pytest.mark.subprocess
def test_a_server_with_another_protocol_is_reported() -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        target = f"connect:127.0.0.1:{server.server_port}"
        output = open_rerun_output(target, RerunConfig(memory_mb=400))
        output.on_update(make_update(0))
        wait_until(lambda: ABSENT in output.warning)
        output.close()
        server.shutdown()
