"""``kinect-vo run`` in a process of its own, on any camera, and what a subscriber hears."""

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from tests.forked_process import ForkedProcess
from tests.ports import free_port, is_listening
from tests.resource_leaks import find_child_running, resources_in_use_by
from tests.vo_service.subscriber import RecordingSubscriber, StatusContent
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

KINECT_VO = str(Path(sys.executable).with_name("kinect-vo"))
# The same, but that a service that takes long to end is not ended by force: the machine may be a
# busy one.
KINECT_VO_WITH_LONG_TIMEOUT = (
    sys.executable,
    "-c",
    """\
from vo_service import signals
from vo_service.cli import command_line

force_exit_after = signals.force_exit_after
signals.force_exit_after = lambda stop, timeout_s: force_exit_after(stop, 100.0)
command_line.main()
""",
)
# Kernels that nobody has compiled yet, on a machine that is busy.
START_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 100.0


class ServiceProcess:
    """The service while it runs."""

    def __init__(
        self,
        process: "subprocess.Popen[bytes]",
        received: RecordingSubscriber,
        log: Path,
        port: int,
    ) -> None:
        self.process, self.received, self._log, self.port = process, received, log, port

    @property
    def status(self) -> StatusContent:
        """The last one received."""
        return self.received.statuses[-1].content if self.received.statuses else {}

    @property
    def log(self) -> str:
        """What it has said on stderr."""
        return self._log.read_text()

    @property
    def driver_pid(self) -> int:
        """Process number of the driver; fails unless there is exactly one."""
        return find_child_running(self.process.pid, "drivers.subprocess_camera.worker:run_camera")

    def resources_in_use(self) -> Counter[str]:
        """Open files, threads, mapped frames and processes (zombies too) of the service."""
        return resources_in_use_by(self.process.pid)

    def wait_for_reason(
        self, reason_text: str, since_s: float, limit_s: float = DEFAULT_TIMEOUT_S
    ) -> float:
        """Wait until a status gives this reason for having no camera; when that was received."""

        def times_s() -> Iterator[float]:
            for status in reversed(self.received.statuses):
                if status.has_camera_reason(reason_text):
                    yield status.receive_time_s

        return self._wait_for_first(times_s, since_s, limit_s, f"a status with {reason_text!r}")

    def wait_until_streaming(self, since_s: float, limit_s: float = DEFAULT_TIMEOUT_S) -> float:
        """Wait for the first pose after `since_s` and a status that agrees; return when it came."""
        received_s = self._wait_for_first(
            lambda: (pose.receive_time_s for pose in reversed(self.received.poses)),
            since_s,
            limit_s,
            "poses",
        )
        self.wait_for_status(lambda status: status["state"] != "no_camera", limit_s)
        return received_s

    def wait_for_status(
        self, holds: Callable[[StatusContent], bool], limit_s: float = DEFAULT_TIMEOUT_S
    ) -> None:
        """Wait until the status is so."""
        agreed = self.received.wait_for(lambda: bool(self.status) and holds(self.status), limit_s)
        assert agreed, f"the status never became so; it is {self._describe()}"

    def stop(self) -> int:
        """Ask it to end; its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(STOP_TIMEOUT_S)

    def _wait_for_first(
        self, times: Callable[[], Iterator[float]], since_s: float, limit_s: float, what: str
    ) -> float:
        """The first of these times, told newest first, at or after `since_s`."""

        def found() -> list[float]:
            late = []
            for received_s in times():
                if received_s < since_s:
                    break
                late.append(received_s)
            return late

        assert self.received.wait_for(lambda: bool(found()), limit_s), (
            f"waited in vain for {what}; the status is {self._describe()}"
        )
        return found()[-1]

    def _describe(self) -> str:
        return f"{json.dumps(dict(self.status))}; the log:\n{self.log}"


# What a service need not do where nobody looks at its maps: their process costs half a second, and
# the libraries of places another.
NO_MAP_CONFIG = "[map]\nenabled = false\n"
NO_LOOP_CLOSURE_CONFIG = "[map]\nloop_closure = false\n"
ONLY_POSES_CONFIG = f"{NO_MAP_CONFIG}[recorder]\nenabled = false\n"


@contextmanager
def running_service(
    folder: Path,
    environment: Mapping[str, str],
    *options: str,
    source: str = "freenect",
    more_config: str = "",
    popen: "Callable[..., subprocess.Popen[bytes]]" = ForkedProcess,
) -> Iterator[ServiceProcess]:
    """``kinect-vo run --camera SOURCE`` that publishes on a free port; killed at the end.

    `more_config` goes on with the table ``[zenoh]`` of its configuration, or begins others. `popen`
    starts it.
    """
    folder.mkdir(exist_ok=True)
    port = free_port()
    config, log = folder / "kinect.toml", folder / "log.txt"
    config.write_text(
        f'schema = 1\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n{more_config}',
        encoding="utf-8",
    )
    command = [
        *KINECT_VO_WITH_LONG_TIMEOUT,
        "run",
        "--camera",
        source,
        "--config",
        str(config),
        *options,
    ]
    received = RecordingSubscriber()
    with log.open("wb") as said:
        process = popen(
            command,
            env={**os.environ, "STATE_DIRECTORY": str(folder / "state"), **environment},
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
    try:
        _wait_until_listening(port, process, log)
        connect = ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))
        with open_session(connect) as session:
            session.declare_subscriber("kinect/odom", received.on_pose)
            session.declare_subscriber("kinect/status", received.on_status)
            yield ServiceProcess(process, received, log, port)
    finally:
        process.kill()
        process.wait()


def _wait_until_listening(port: int, process: "subprocess.Popen[bytes]", log: Path) -> None:
    def listens() -> bool:
        assert process.poll() is None, f"the service has ended: {log.read_text()}"
        return is_listening(port)

    wait_until(listens, f"the service to listen; its log is {log}", timeout_s=START_TIMEOUT_S)
