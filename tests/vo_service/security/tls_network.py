"""A TLS network with its own keys: the project's Zenoh files on local addresses."""

import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import zenoh
import zenoh.ext

from drivers.core import UserFacingError
from tests.ports import free_port
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.sample_map import make_map
from vo_service.config_tables import CommandConfig, ZenohConfig
from vo_service.control import CommandQueue
from vo_service.outputs.zenoh.base_subscription import BaseSubscription, velocity_key, wheel_key
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints, make_command_endpoint
from vo_service.tools.certificates import CertificateAuthority
from vo_service.types.commands import Command, PausedReply

ZENOH_FILES = Path(__file__).parents[3] / "config" / "zenoh"
HOST = "127.0.0.1"
CLIENTS = ("reader", "viewer", "operator", "robot1", "robot2")
VALIDITY_DAYS = 2


def make_keys(folder: Path) -> Path:
    """Make an authority with a server and clients, and a second, untrusted authority."""
    ours, strange = CertificateAuthority(folder / "ours"), CertificateAuthority(folder / "strange")
    ours.issue_client_certificate("late", 0)  # over as soon as it is made
    ours.issue_server_certificate([HOST, "localhost"], VALIDITY_DAYS)
    for name in CLIENTS:
        ours.issue_client_certificate(name, VALIDITY_DAYS)
    strange.issue_client_certificate("operator", VALIDITY_DAYS)
    return folder


@dataclass(frozen=True)
class TlsNetwork:
    """The folder of the files, and the ports that replace those of robot-tls.json5."""

    folder: Path
    tls_port: int
    local_port: int

    def file(self, name: str, identity: str) -> Path:
        """Write a Zenoh file of the project beside the keys of ours/NAME or strange/NAME."""
        text = (ZENOH_FILES / name).read_text()
        # Robots of a fleet are many on this one computer.
        local_port = self.local_port if name == "robot-tls.json5" else free_port()
        for written, here in {
            "0.0.0.0:7451": f"{HOST}:{self.tls_port}",
            "robot1.local:7451": f"{HOST}:{self.tls_port}",
            "0.0.0.0:7447": f"{HOST}:{self.tls_port}",
            "router.local:7447": f"{HOST}:{self.tls_port}",
            "127.0.0.1:7450": f"{HOST}:{local_port}",
        }.items():
            text = text.replace(written, here)
        file = self.folder / identity / name
        file.write_text(text)
        return file

    def open_session(self, name: str, identity: str) -> zenoh.Session:
        """Open a session with a Zenoh file and keys, as a user would."""
        return open_session(ZenohConfig(config_file=self.file(name, identity), listen=()))

    @property
    def server_identity(self) -> str:
        """Identity whose keys the listening side has."""
        return f"ours/{HOST}"


def can_connect(file: Path) -> bool:
    """Return whether a client with this Zenoh file can connect."""
    try:
        open_session(ZenohConfig(config_file=file, listen=())).close()  # type: ignore[no-untyped-call]
    except UserFacingError:
        return False
    return True


def make_network(keys: Path, folder: Path) -> TlsNetwork:
    """Make copies of the keys, which a test may change, and choose free ports."""
    shutil.copytree(keys, folder, dirs_exist_ok=True)
    return TlsNetwork(folder, free_port(), free_port())


class TlsRobot:
    """The service's publisher, 30 poses a second with one map, and a loop that runs any command."""

    def __init__(self, file: Path) -> None:
        self.stop = threading.Event()
        self.executed: list[Command] = []
        self.base_messages: list[bytes] = []
        self._command_queue = CommandQueue()
        commands = make_command_endpoint(CommandConfig(), self._command_queue)
        config = ZenohConfig(config_file=file)
        subscriptions = tuple(
            BaseSubscription(key(config.prefix), self.base_messages.append).declare
            for key in (wheel_key, velocity_key)
        )
        endpoints = ExtraEndpoints(commands, subscriptions=subscriptions)
        self._output = ZenohOutput(config, extra_endpoints=endpoints)

    @property
    def session(self) -> zenoh.Session:
        """The session of the poses."""
        return self._output._endpoints[0].session

    def put(self, key: str, payload: bytes) -> None:
        """Publish something on the session of the poses."""
        self.session.put(key, payload)

    def run(self) -> None:
        """Publish until `stop` is set."""
        seq, snapshot = 0, make_map()
        while not self.stop.wait(1 / 30):
            self._output.on_update(replace(make_update(seq), map=snapshot))
            seq += 1
            for future in self._command_queue.take_pending():
                self.executed.append(future.command)
                future.set_result(PausedReply(True))
        self._output.close()


@contextmanager
def running_robot(network: TlsNetwork) -> Iterator[TlsRobot]:
    """Run a robot with robot-tls.json5 while the block runs."""
    robot = TlsRobot(network.file("robot-tls.json5", network.server_identity))
    thread = threading.Thread(target=robot.run)
    thread.start()
    try:
        yield robot
    finally:
        robot.stop.set()
        thread.join()


@contextmanager
def receive_pose_numbers(session: zenoh.Session) -> Iterator[list[int]]:
    """Collect the numbers of the poses while the block runs; wait for the first."""
    numbers: list[int] = []
    first = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        numbers.append(json.loads(sample.attachment.to_bytes())["seq"])
        first.set()

    with session.declare_subscriber("*/odom", on_sample):
        assert first.wait(100), "no pose arrived"
        yield numbers


def receives_kept_message(session: zenoh.Session, key: str) -> bool:
    """Return whether a latched message that was sent before arrives."""
    received = threading.Event()
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        lambda _: received.set(),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    try:
        return received.wait(20)
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]


def is_contiguous(numbers: list[int]) -> bool:
    """Return whether no number is missing or repeated."""
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def query_replies(session: zenoh.Session, key: str, payload: bytes = b"{}") -> list[bytes]:
    """Return all replies to a query, also errors."""
    replies = session.get(key, payload=payload, timeout=60.0)
    return [(reply.ok or reply.err).payload.to_bytes() for reply in replies]  # type: ignore[union-attr]
