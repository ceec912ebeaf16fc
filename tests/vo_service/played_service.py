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

from tests.belongings import belongings_of, child_running
from tests.ports import free_port, is_listening
from tests.preloaded import Preloaded
from tests.vo_service.subscriber import Status, Subscriber
from tests.waiting import PATIENCE_S, wait_until
from vo_service.outputs.zenoh_session import open_session
from vo_service.settings import ZenohConfig

KINECT_VO = str(Path(sys.executable).with_name("kinect-vo"))
# The same, but that a service that takes long to end is not ended by force: the machine may be a
# busy one.
PATIENT_KINECT_VO = (
    sys.executable,
    "-c",
    """\
from vo_service import cli, interrupts

by_force = interrupts.ended_by_force
interrupts.ended_by_force = lambda stop, after_s: by_force(stop, 100.0)
cli.main()
""",
)
# Kernels that nobody has compiled yet, on a machine that is busy.
START_LIMIT_S = 120.0
ENDING_S = 100.0


class PlayedService:
    """The service while it runs."""

    def __init__(
        self, process: "subprocess.Popen[bytes]", heard: Subscriber, log: Path, port: int
    ) -> None:
        self.process, self.heard, self._log, self.port = process, heard, log, port

    @property
    def status(self) -> Status:
        """The last one heard."""
        return self.heard.statuses[-1].content if self.heard.statuses else {}

    @property
    def log(self) -> str:
        """What it has said on stderr."""
        return self._log.read_text()

    @property
    def driver(self) -> int:
        """Process number of the driver; fails unless there is exactly one."""
        return child_running(self.process.pid, "drivers.isolation.child")

    def belongings(self) -> Counter[str]:
        """Open files, threads, mapped frames and processes (zombies too) of the service."""
        return belongings_of(self.process.pid)

    def until_said(self, words: str, since_s: float, limit_s: float = PATIENCE_S) -> float:
        """Wait until a status gives this reason for having no camera; when that was heard."""
        return self._first(
            lambda: (s.heard_s for s in reversed(self.heard.statuses) if s.says(words)),
            since_s, limit_s, f"a status with {words!r}",
        )  # fmt: skip

    def until_streaming(self, since_s: float, limit_s: float = PATIENCE_S) -> float:
        """Wait for the first pose heard after `since_s`, and a status that agrees; when it was."""
        heard_s = self._first(
            lambda: (pose.heard_s for pose in reversed(self.heard.poses)), since_s, limit_s, "poses"
        )
        self.until(lambda status: status["state"] != "no_camera", limit_s)
        return heard_s

    def until(self, holds: Callable[[Status], bool], limit_s: float = PATIENCE_S) -> None:
        """Wait until the status is so."""
        agreed = self.heard.wait_for(lambda: bool(self.status) and holds(self.status), limit_s)
        assert agreed, f"the status never became so; it is {self._situation()}"

    def end(self) -> int:
        """Ask it to end; its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(ENDING_S)

    def _first(
        self, times: Callable[[], Iterator[float]], since_s: float, limit_s: float, what: str
    ) -> float:
        """The first of these times, told newest first, at or after `since_s`."""

        def found() -> list[float]:
            late = []
            for heard_s in times():
                if heard_s < since_s:
                    break
                late.append(heard_s)
            return late

        assert self.heard.wait_for(lambda: bool(found()), limit_s), (
            f"waited in vain for {what}; the status is {self._situation()}"
        )
        return found()[-1]

    def _situation(self) -> str:
        return f"{json.dumps(dict(self.status))}; the log:\n{self.log}"


# What a service need not do where nobody looks at its maps: their process costs half a second, and
# the libraries of places another.
WITHOUT_MAP = "[map]\nenabled = false\n"
WITHOUT_PLACES = "[map]\nloops = false\n"


@contextmanager
def running_service(
    folder: Path,
    environment: Mapping[str, str],
    *options: str,
    source: str = "freenect",
    more_config: str = "",
) -> Iterator[PlayedService]:
    """``kinect-vo run --camera SOURCE`` that publishes on a free port; killed at the end.

    `more_config` goes on with the table ``[zenoh]`` of its configuration, or begins others.
    """
    folder.mkdir(exist_ok=True)
    port = free_port()
    config, log = folder / "kinect.toml", folder / "log.txt"
    config.write_text(
        f'schema = 1\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n{more_config}',
        encoding="utf-8",
    )
    command = [*PATIENT_KINECT_VO, "run", "--camera", source, "--config", str(config), *options]
    heard = Subscriber()
    with log.open("wb") as said:
        process = Preloaded(
            command,
            env={**os.environ, "STATE_DIRECTORY": str(folder / "state"), **environment},
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
    try:
        _until_listening(port, process, log)
        connect = ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))
        with open_session(connect) as session:
            session.declare_subscriber("kinect/odom", heard.take_pose)
            session.declare_subscriber("kinect/status", heard.take_status)
            yield PlayedService(process, heard, log, port)
    finally:
        process.kill()
        process.wait()


def _until_listening(port: int, process: "subprocess.Popen[bytes]", log: Path) -> None:
    def listens() -> bool:
        assert process.poll() is None, f"the service has ended: {log.read_text()}"
        return is_listening(port)

    wait_until(listens, f"the service to listen; its log is {log}", timeout_s=START_LIMIT_S)
