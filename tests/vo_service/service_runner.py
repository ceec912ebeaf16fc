"""A place for a service that lives more than once: its files, its port, and one who listens to it.

The camera is the virtual Kinect, small and still: what goes wrong here is all around it.
"""

import json
import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh

from tests.forked_process import ForkedProcess
from tests.ports import free_port
from tests.vo_service.received_checks import check_received
from tests.vo_service.service_process import KINECT_VO_WITH_LONG_TIMEOUT, ServiceProcess
from tests.vo_service.subscriber import RecordingSubscriber
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

CAMERA = """
[camera]
source = "synthetic"
[synthetic]
motion = "still"
duration_s = 0.2
loop = true
texel_m = 0.01
camera = { width = 320, height = 240, fx = 262.5, fy = 262.5, cx = 159.5, cy = 119.5 }
color = { distortion = [0.0, 0.0, 0.0, 0.0, 0.0], exposure_s = 0.0, smooth_edges = false }
"""


class ServiceRunner:
    """Starts services, one after another, and keeps what is received of each."""

    def __init__(self, folder: Path, sequences: Path, more_config: str) -> None:
        """`sequences` keeps what is rendered. `more_config` goes on with ``[zenoh]``, then more."""
        self.port = free_port()
        self.config = folder / "kinect.toml"
        self._folder = folder
        self._environment = {
            **os.environ,
            "STATE_DIRECTORY": str(folder / "state"),
            "CACHE_DIRECTORY": str(sequences),
        }
        self._lives: list[ServiceProcess] = []
        listen = f'[zenoh]\nlisten = ["tcp/127.0.0.1:{self.port}"]\n'
        self.good_config = f"schema = 1\n{listen}{more_config}"
        self.config.write_text(self.good_config)
        connect = ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{self.port}",))
        self.session = open_session(connect)
        self._subscribers: list[zenoh.Subscriber[None]] = []

    @property
    def state_folder(self) -> Path:
        """Where the service keeps incidents and recordings."""
        return self._folder / "state"

    @property
    def has_started(self) -> bool:
        """Whether there was ever a service."""
        return bool(self._lives)

    @property
    def service(self) -> ServiceProcess:
        """The one that was started last."""
        return self._lives[-1]

    def start(
        self, *options: str, popen: "type[subprocess.Popen[bytes]]" = ForkedProcess
    ) -> ServiceProcess:
        """Start the service, by `popen`; the one before must be dead."""
        assert not self.has_started or self.service.process.poll() is not None
        received = self._subscribe()
        log = self._folder / f"log-{len(self._lives)}.txt"
        command = [*KINECT_VO_WITH_LONG_TIMEOUT, "run", "--config", str(self.config), *options]
        with log.open("wb") as said:
            process = popen(
                command, env=self._environment, stdout=said, stderr=said, start_new_session=True
            )
        self._lives.append(ServiceProcess(process, received, log, self.port))
        return self.service

    def _subscribe(self) -> RecordingSubscriber:
        """Hear the next service only: nothing that the one before has left on the way."""
        wait_until(lambda: not self.session.info.peers_zid(), "the last service to disconnect")
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        received, declare = RecordingSubscriber(), self.session.declare_subscriber
        self._subscribers = [
            declare("kinect/odom", received.on_pose),
            declare("kinect/status", received.on_status),
        ]
        return received

    def send_command(self, command: str, **arguments: object) -> Mapping[str, Any]:
        """Send a command; its answer. Fails if it is refused."""
        reply = self._query(command, arguments)
        assert reply.ok is not None, reply.err.payload.to_string()
        answer: Mapping[str, Any] = json.loads(reply.ok.payload.to_bytes())
        return answer

    def is_accepted(self, command: str, **arguments: object) -> bool:
        """Send a command that may be refused for now."""
        return self._query(command, arguments).ok is not None

    def _query(self, command: str, arguments: Mapping[str, object]) -> Any:
        key, payload = f"kinect/command/{command}", json.dumps(arguments).encode()
        replies: Any = self.session.get(key, payload=payload, timeout=DEFAULT_TIMEOUT_S)
        (reply,) = replies
        return reply

    def check(self) -> None:
        """See `check_received`: every life of the service."""
        for life in self._lives:
            check_received(life.received, life.log)

    def close(self) -> None:
        """Kill what still runs."""
        for life in self._lives:
            life.process.kill()
            life.process.wait()
        self.session.close()  # type: ignore[no-untyped-call]


@contextmanager
def service_runner(
    folder: Path, sequences: Path, more_config: str = CAMERA
) -> Iterator[ServiceRunner]:
    """A stage without a service yet; whatever was started on it is killed at the end."""
    folder.mkdir(parents=True, exist_ok=True)
    stage = ServiceRunner(folder, sequences, more_config)
    try:
        yield stage
    finally:
        stage.close()
