"""Output of poses and status over Zenoh: how it opens its session, and its own thread."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import zenoh

from drivers.core import UserFacingError
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue, WorkerThread
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.addresses import (
    connect_endpoints,
    is_connected_to_any,
    session_endpoints,
)
from vo_service.outputs.zenoh.session import ZenohUnavailableError, log_connections, open_session
from vo_service.outputs.zenoh.session_endpoints import (
    EndpointConfig,
    ExtraEndpoints,
    LatestMessages,
    Queryables,
    SessionEndpoints,
)
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.messages import (
    Status,
    encode_message,
    grid_payload,
    map_odom_message,
    pose_attachment,
    pose_payload,
    versions,
)
from vo_service.types.occupancy_grid import NO_GRID
from vo_service.types.odometry_update import OdometryUpdate

logger = logging.getLogger(__name__)

RETRY_S = 2.0
# No warning for this long after a router disconnects.
ROUTER_GRACE_S = 3.0


class ZenohConnection(Protocol):
    """A session, or the attempts to open it.

    Attributes:
        warning: Why there is no connection; "" while there is one.
        description: Where the session can be reached, for people.
    """

    warning: str
    description: str

    def sessions(self) -> list[zenoh.Session]:
        """Return the open session, if any."""
        ...


# Makes a connection. Raises InputError if the configuration is invalid: retrying cannot help.
ConnectPolicy = Callable[[ZenohConfig], ZenohConnection]


class ConnectOnce:
    """Policy for interactive programs: a session that cannot open now is an error."""

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Open the session. Raises InputError or ZenohUnavailableError."""
        self._session = open_session(config)
        self.description = describe(config)

    def sessions(self) -> list[zenoh.Session]:
        """Return the session, which may have been closed since."""
        return [self._session]


class ConnectWithRetry:
    """Policy for a robot: retries every two seconds and warns until it succeeds."""

    def __init__(self, config: ZenohConfig, now_s: Callable[[], float] = time.monotonic) -> None:
        """Try to open the session.

        Raises:
            InputError: If retrying would not help.
        """
        self._config = config
        self._now_s = now_s
        self.description = describe(config)
        self._routers = _RouterMonitor(connect_endpoints(config), now_s)
        self._opened: list[zenoh.Session] = []
        self._tried_s = now_s()
        self.warning = ""
        try:
            self._opened = [_open_logged_session(config)]
        except ZenohUnavailableError as error:
            self._set_warning(f"{error.clause}; trying again: {error.advice}")

    def sessions(self) -> list[zenoh.Session]:
        """Return the open session, if any; retries and updates the warning, so call it often."""
        if not self._opened or self._opened[0].is_closed():
            self._opened = []
            self._retry()
        for session in self._opened:
            self._set_warning(self._routers.warning(session))
        return self._opened

    def _retry(self) -> None:
        if self._now_s() - self._tried_s < RETRY_S:
            return
        try:
            self._opened = [_open_logged_session(self._config)]
        except ZenohUnavailableError as error:
            self._set_warning(f"{error.clause}; trying again: {error.advice}")
        except UserFacingError as error:  # a configuration file has changed since the start
            self._set_warning(f"{error}; trying again")
        self._tried_s = self._now_s()

    def _set_warning(self, problem: str) -> None:
        """Set the warning and log it if it has changed."""
        warning = f"zenoh: {problem}" if problem else ""
        if warning == self.warning:
            return
        self.warning = warning
        logger.warning("%s", warning or "zenoh: connected again")


def _open_logged_session(config: ZenohConfig) -> zenoh.Session:
    session = open_session(config)
    log_connections(session)
    return session


def describe(config: ZenohConfig) -> str:
    """Describe where a session can be reached, for people."""
    endpoints, command = session_endpoints(config), ["kinect-vo listen"]
    if config.prefix != ZenohConfig.prefix:
        command += ["--prefix", config.prefix]
    # Over TLS it needs the certificates of a reader.
    if DEFAULT_ENDPOINT not in endpoints and endpoints[:1] and endpoints[0].startswith("tcp/"):
        command += ["--connect", endpoints[0]]
    return f"{', '.join(endpoints)} ({' '.join(command)})"


class _RouterMonitor:
    """Warns while none of the routers is connected."""

    def __init__(self, endpoints: Iterable[str], now_s: Callable[[], float]) -> None:
        self._endpoints = tuple(endpoints)
        self._now_s = now_s
        self._last_connected_s = now_s()

    def warning(self, session: zenoh.Session) -> str:
        """Return the warning; "" while a router is connected or none is configured."""
        if not self._endpoints or is_connected_to_any(session, self._endpoints):
            self._last_connected_s = self._now_s()
        if self._now_s() - self._last_connected_s < ROUTER_GRACE_S:
            return ""
        routers = " or ".join(self._endpoints)
        return f"no connection to {routers}: it is down or denies access; trying again"


ZenohItem = OdometryUpdate | Status


@dataclass(frozen=True)
class QosProfile:
    """Whether a slow subscriber misses messages or slows the publisher down.

    Attributes:
        congestion: What Zenoh does if a link is congested.
        make_queue: Makes the queue of results.
        min_idle_checks: Successive checks without unread data before the session closes.
        drain_timeout_s: Longest wait for subscribers to read, at the end.
        close_timeout_s: Longest wait for the worker thread, at the end.
    """

    congestion: zenoh.CongestionControl
    make_queue: Callable[[], BoundedQueue[ZenohItem]]
    min_idle_checks: int
    drain_timeout_s: float
    close_timeout_s: float


# A robot cannot wait for a slow subscriber: the newest pose matters.
LIVE_QOS = QosProfile(
    zenoh.CongestionControl.DROP,
    lambda: DropOldestQueue(4),
    0,
    drain_timeout_s=0.0,
    close_timeout_s=2.0,
)
# A replay can wait: every pose arrives, in order.
LOCKSTEP_QOS = QosProfile(
    zenoh.CongestionControl.BLOCK,
    lambda: BlockingQueue(16),
    2,
    drain_timeout_s=10.0,
    close_timeout_s=25.0,
)


class ZenohOutput:
    """Publishes poses, the map->odom transform and the status; replies to queries.

    Keys under `{prefix}`; `docs/reference/messages.md` has the details:

    - odom: CDR ``nav_msgs/msg/Odometry``; attachment: JSON of schema, seq, state, epoch, reason
    - map_odom: map->odom transform, if there is a map: on each change, at each new epoch and with
      each status. CDR ``geometry_msgs/msg/TransformStamped``; attachment: JSON of schema, seq,
      epoch, is_localized, map_keyframes, loop_closures
    - map: occupancy grid, if there is a map, on change: CDR ``nav_msgs/msg/OccupancyGrid``, latched
    - status: JSON of schema, every field of `Status`, versions
    - alive: liveliness token of this object
    - latest, map_odom, map, status, schema, command/NAME: queryables

    A pose with a number that is not finite is never published; the error is logged and counted.

    Args:
        config: Prefix, frames and endpoints.
        qos: How to treat slow subscribers.
        connect_policy: Opens the session; its errors are raised.
        extra_endpoints: Commands and others; None is none of them.
    """

    def __init__(
        self,
        config: ZenohConfig,
        qos: QosProfile = LIVE_QOS,
        connect_policy: ConnectPolicy = ConnectOnce,
        extra_endpoints: ExtraEndpoints | None = None,
    ) -> None:
        self._extra = extra_endpoints or ExtraEndpoints()
        self._qos = qos
        self._versions = versions()
        self._latest: LatestMessages = {}
        self._endpoint_config = EndpointConfig(
            prefix=config.prefix,
            congestion=qos.congestion,
            queryables=Queryables(config.prefix, self._latest),
            extra=self._extra,
        )
        # The map that was last published, and its epoch.
        self._published_map: tuple[MapSnapshot, int] = (NO_MAP, 0)
        self._map_update: OdometryUpdate | None = None  # the last one with a map
        self._published_grid = NO_GRID
        self._error = ""
        self._connection = connect_policy(config)
        self._endpoints: list[SessionEndpoints] = []
        self._sync_endpoints()
        self._worker: WorkerThread[ZenohItem] = WorkerThread(
            "zenoh", qos.make_queue(), self._publish, self._finish
        )

    @property
    def warning(self) -> str:
        """The fault of the session, or of the last message; "" if there is none."""
        return self._connection.warning or self._error

    @property
    def description(self) -> str:
        """The prefix, the endpoints and how to listen to them, for people."""
        return f"{self._endpoint_config.prefix}/odom at {self._connection.description}"

    @property
    def dropped(self) -> int:
        """Number of results dropped from the queue."""
        return self._worker.dropped

    @property
    def errors(self) -> int:
        """Number of results that could not be published."""
        return self._worker.errors

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue one pose."""
        self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put(status)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until there is a subscriber to the poses; return False on timeout."""
        return any(endpoints.wait_for_subscriber(timeout_s) for endpoints in self._endpoints)

    def close(self) -> None:
        """Publish what is queued, let subscribers read it, and close the session."""
        self._worker.close(self._qos.close_timeout_s)

    def _publish(self, item: ZenohItem) -> None:
        try:
            self._publish_status(item) if isinstance(item, Status) else self._publish_pose(item)
        except (ValueError, zenoh.ZError) as error:
            self._error = f"zenoh: a message could not be published: {error}"
            raise
        self._error = ""

    def _publish_pose(self, update: OdometryUpdate) -> None:
        payload = pose_payload(update, self._extra.frame_ids)
        attachment = pose_attachment(update)
        self._latest["latest"] = lambda: (payload, attachment)
        self._send("odom", payload, attachment)
        if update.map is not NO_MAP:
            self._publish_map(update)
        if update.grid is not self._published_grid:
            self._publish_grid(update)
        self._extra.on_pose(update)

    def _publish_map(self, update: OdometryUpdate) -> None:
        """Store the transform with the newest stamp; publish it if the map or epoch changed.

        Most are never sent, so each is encoded when it is.
        """
        encode = partial(map_odom_message, update, self._extra.frame_ids)
        current = (update.map, update.epoch)
        has_changed = current != self._published_map
        if has_changed:
            encode()  # raises for a transform that nobody can read, which is then not stored
        self._latest["map_odom"], self._map_update = encode, update
        if has_changed:
            self._published_map = current
            self._send_map()

    def _publish_grid(self, update: OdometryUpdate) -> None:
        """Store and publish a changed occupancy grid."""
        self._published_grid = update.grid
        payload = grid_payload(update, self._extra.frame_ids)
        self._latest["map"] = lambda: (payload, None)
        self._send("map", payload)

    def _send_map(self) -> None:
        if "map_odom" in self._latest:
            self._send("map_odom", *self._latest["map_odom"]())

    def _send(self, name: str, payload: bytes, attachment: bytes | None = None) -> None:
        for endpoints in self._endpoints:
            endpoints.publish(name, payload, attachment)

    def _publish_status(self, status: Status) -> None:
        payload = encode_message(status, {"versions": self._versions})
        self._latest["status"] = lambda: (payload, None)
        self._sync_endpoints()
        self._send("status", payload)
        self._mark_map_as_lost(status)
        self._send_map()  # for new subscribers

    def _mark_map_as_lost(self, status: Status) -> None:
        """Store that the transform is unknown: without poses, the status says it first."""
        last = self._map_update
        if last is not None and last.is_localized and not status.map.is_localized:
            last = replace(last, map=replace(last.map, is_localized=False))
            self._latest["map_odom"] = partial(map_odom_message, last, self._extra.frame_ids)

    def _sync_endpoints(self) -> None:
        """Declare the endpoints on the open session, if they are not declared there yet."""
        sessions = self._connection.sessions()
        current = [endpoints for endpoints in self._endpoints if endpoints.session in sessions]
        if len(current) < len(sessions):
            current = [SessionEndpoints(session, self._endpoint_config) for session in sessions]
        self._endpoints = current

    def _finish(self) -> None:
        self._extra.commands.close()
        for endpoints in self._endpoints:
            if not self._drain(endpoints):
                logger.warning("zenoh: a subscriber does not read; its last poses are lost")
            endpoints.close()

    def _drain(self, endpoints: SessionEndpoints) -> bool:
        """Wait until subscribers have read everything; return False on timeout.

        Closing first would lose data: a subscriber that still reads sends a keep-alive, the closed
        socket resets the connection, and the kernel discards undelivered data.
        """
        deadline_s = time.monotonic() + self._qos.drain_timeout_s
        idle_checks = 0
        while idle_checks < self._qos.min_idle_checks:
            if time.monotonic() > deadline_s:
                return False
            idle_checks = 0 if unread_bytes(endpoints.session) else idle_checks + 1
            time.sleep(0.01)
        return True


PROC_TCP_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

PortPair = tuple[int, int]


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


def unread_bytes(session: zenoh.Session) -> int:
    """Return how many sent bytes of a session have not been read yet."""
    links = session.info.links()
    return queued_bytes((_port(link.src), _port(link.dst)) for link in links)


def _port(locator: str) -> int:
    """Return the port of a locator, such as tcp/127.0.0.1:7450; 0 if it has none."""
    port = locator.rsplit(":", 1)[-1]
    return int(port) if port.isdigit() else 0
