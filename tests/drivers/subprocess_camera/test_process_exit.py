"""The driver's process ends with the service, however that ends; and it starts light."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.forked_process import ForkedProcess
from tests.resource_leaks import is_alive
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

SERVICE = """
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from drivers.camera import Clock, FrameTimeout, PlaybackMode
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.resource_leaks import child_pids, resources_in_use
from tests.drivers.subprocess_camera.scripted_cameras import FileScriptedCamera

script, action = Path(sys.argv[1]), sys.argv[2]
before = resources_in_use()
timeouts = Timeouts(heartbeat_s=60.0, closing_s=0.3, orphan_s=0.6)
factory = partial(FileScriptedCamera, script)
camera = SubprocessCamera("scripted", Clock.MONOTONIC, factory, PlaybackMode.REALTIME, timeouts)
try:
    camera.open()
    camera.read(100.0)
    print(child_pids()[0], flush=True)
    while action == "read":
        camera.read(100.0)
    script.write_text("hang in read")
    with suppress(FrameTimeout):
        while True:
            camera.read(0.5)
    print("closing", flush=True)
    while True:
        camera.close()
except KeyboardInterrupt:
    pass  # its traceback may hold a view of a frame's memory, until here
camera.close()
print(resources_in_use() <= before, flush=True)
"""


@contextmanager
def service(script: Path, action: str) -> Iterator["subprocess.Popen[str]"]:
    """A service at work on a camera; its first line is the number of the driver's process."""
    command = [sys.executable, "-c", SERVICE, str(script), action]
    with ForkedProcess(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def first_line(process: "subprocess.Popen[str]") -> int:
    assert process.stdout is not None
    return int(process.stdout.readline())


@pytest.mark.parametrize("words", ["", "absent in read", "hang in read", "hang with lock in read"])
def test_the_driver_exits_when_the_service_is_killed(script: Path, words: str) -> None:
    with service(script, "read") as process:
        driver = first_line(process)
        script.write_text(words)
        process.kill()
    wait_until(lambda: not is_alive(driver))


@pytest.mark.parametrize("action", ["read", "close"])
def test_ctrl_c_leaves_no_process(script: Path, action: str) -> None:
    with service(script, action) as process:
        driver = first_line(process)
        if action == "close":
            assert process.stdout is not None
            assert process.stdout.readline() == "closing\n"
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=100)
    assert (out, process.returncode) == ("True\n", 0)
    assert not is_alive(driver)


def test_only_the_service_handles_ctrl_c_and_sigterm_of_the_process_group(script: Path) -> None:
    with service(script, "read") as process:
        driver = first_line(process)
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(driver, number)
        assert process.stdout is not None
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "True\n"
    assert not is_alive(driver)


def test_the_driver_process_does_not_import_the_service() -> None:
    names = (
        "import json, sys, drivers.core.process.worker_main, drivers.subprocess_camera.worker; "
        "print(json.dumps(list(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", names], capture_output=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert {"numpy", "drivers"} <= loaded
    assert not {"vo_service", "numba", "zenoh", "rerun", "matplotlib", "usb"} & loaded
