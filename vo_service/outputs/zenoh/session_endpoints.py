"""Everything that the service declares on one open Zenoh session."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from vo_service.config_tables import Ros2Config
from vo_service.outputs.zenoh import FrameIds
from vo_service.outputs.zenoh.queryables import (
    CDR,
    CDR_TRANSFORM,
    JSON,
    CommandEndpoint,
    Queryables,
)
from vo_service.types import OdometryUpdate

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.outputs.zenoh.ros2 import Ros2Publisher

PROC_TCP_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

PortPair = tuple[int, int]
THREAD_JOIN_TIMEOUT_S = 0.5


def queued_bytes(connections: Iterable[PortPair]) -> int:
    """Count the unread bytes of connections, given as (local port, remote port).

    These are unacknowledged bytes and, if the peer runs on this host, bytes in its receive queue.
    """
    pairs = set(connections)
    total = 0
    for local, remote, send_queue, receive_queue in _sockets():
        if (local, remote) in pairs:
            total += send_queue
        elif (remote, local) in pairs:
            total += receive_queue
    return total


def _sockets() -> Iterator[tuple[int, int, int, int]]:
    """Yield local port, remote port, bytes in the send queue, bytes in the receive queue."""
    for table in PROC_TCP_TABLES:
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for line in lines:
            _, local, remote, _, queues = line.split()[:5]
            sending, received = queues.split(":")
            yield _port_of(local), _port_of(remote), int(sending, 16), int(received, 16)


def _port_of(address: str) -> int:
    return int(address.rsplit(":", 1)[1], 16)


@dataclass(frozen=True)
class EndpointConfig:
    """Configuration of the endpoints on one session."""

    prefix: str
    frame_ids: FrameIds
    congestion: zenoh.CongestionControl
    queryables: Queryables
    commands: CommandEndpoint
    ros2: Ros2Config
    on_session: Callable[[zenoh.Session], None] = lambda _: None


class SessionEndpoints:
    """Publishers, queryables, commands and the liveliness token `alive` of one session.

    The token is declared last: a client that sees it finds everything else.

    Raises:
        InputError: The ROS 2 topic is invalid.
    """

    def __init__(self, session: zenoh.Session, config: EndpointConfig) -> None:
        self.session = session
        prefix = config.prefix
        self._odom = session.declare_publisher(
            f"{prefix}/odom",
            encoding=CDR,
            congestion_control=config.congestion,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._map_odom = session.declare_publisher(
            f"{prefix}/map_odom",
            encoding=CDR_TRANSFORM,
            congestion_control=config.congestion,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._status = session.declare_publisher(
            f"{prefix}/status", encoding=JSON, congestion_control=config.congestion
        )
        self._ros2 = _open_ros2(session, config)
        self._threads = config.queryables.declare(session)
        self._threads += config.commands.declare(session, prefix)
        config.on_session(session)
        self._alive = session.liveliness().declare_token(f"{prefix}/alive")

    def publish_pose(self, update: OdometryUpdate, payload: bytes, attachment: bytes) -> None:
        """Publish one pose; `payload` is its CDR."""
        self._odom.put(payload, attachment=attachment)
        if self._ros2 is not None:
            self._ros2.publish(update, payload)

    def publish_map_odom(self, payload: bytes, attachment: bytes) -> None:
        """Publish the map->odom transform."""
        self._map_odom.put(payload, attachment=attachment)

    def publish_status(self, payload: bytes) -> None:
        """Publish a status."""
        self._status.put(payload)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until there is a subscriber to the poses; return False on timeout."""
        is_matched = threading.Event()

        def on_change(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                is_matched.set()

        listener = self._odom.declare_matching_listener(on_change)
        try:
            return _has_subscriber(self._odom) or is_matched.wait(timeout_s)
        finally:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def queued_bytes(self) -> int:
        """Return how many sent bytes have not been read yet."""
        links = self.session.info.links()
        return queued_bytes((_port(link.src), _port(link.dst)) for link in links)

    def close(self) -> None:
        """Withdraw the token and close the session."""
        parts: list[Callable[[], object]] = [self._alive.undeclare, self.session.close]
        if self._ros2 is not None:
            parts.insert(1, self._ros2.close)
        for close in parts:
            with suppress(zenoh.ZError):  # a broken link
                close()
        # A thread that is still inside Zenoh when Python exits crashes the process.
        for thread in self._threads:
            thread.join(THREAD_JOIN_TIMEOUT_S)


def _open_ros2(session: zenoh.Session, config: EndpointConfig) -> "Ros2Publisher | None":
    """Publish for ROS 2 if it is enabled."""
    if not config.ros2.enabled:
        return None
    from vo_service.outputs.zenoh.ros2 import Ros2Publisher

    return Ros2Publisher(session, config.ros2, config.prefix, config.frame_ids, config.congestion)


def _has_subscriber(publisher: zenoh.Publisher) -> bool:
    # Zenoh's stub declares bool, but the value is an object that is always true.
    status: zenoh.MatchingStatus = publisher.matching_status  # type: ignore[assignment]
    return status.matching


def _port(locator: str) -> int:
    """Return the port of a locator, such as tcp/127.0.0.1:7450; 0 if it has none."""
    port = locator.rsplit(":", 1)[-1]
    return int(port) if port.isdigit() else 0
