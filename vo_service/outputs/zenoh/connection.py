"""Connections of a Zenoh session: policies to open it, and how much its readers have not read."""

import logging
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import zenoh

from drivers.core import UserFacingError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh import (
    ZenohPortInUseError,
    ZenohUnavailableError,
    connect_endpoints,
    is_connected_to_any,
    open_session,
    session_endpoints,
)

logger = logging.getLogger(__name__)


RETRY_S = 2.0
# No warning for this long after a router disconnects.
ROUTER_GRACE_S = 3.0
# Another program may take a free port before Zenoh opens it.
MAX_PORT_ATTEMPTS = 5
_MAX_NAME_CHARS = 64


class ConnectOnce:
    """Policy for interactive programs: a session that cannot open now is an error."""

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Open the session. Raises InputError or ZenohUnavailableError."""
        self._session = open_session(config)
        self.description = _describe(config)

    def sessions(self) -> list[zenoh.Session]:
        """Return the session, which may have been closed since."""
        return [self._session]


class ConnectOnFreePort:
    """Policy for a replay: uses a free local port if the default port is in use.

    If the user has set an endpoint or a Zenoh configuration, a port in use is an error.
    """

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Open the session. Raises InputError or ZenohUnavailableError."""
        try:
            self._session = open_session(config)
            self.description = _describe(config)
        except ZenohPortInUseError:
            if config.listen != (DEFAULT_ENDPOINT,) or config.config_file is not None:
                raise
            self._session, endpoint = _open_on_free_port(config)
            self.description = (
                f"{endpoint}, as {DEFAULT_ENDPOINT} is in use (kinect-vo listen --connect "
                f"{endpoint})"
            )

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
        self.description = _describe(config)
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


# Makes a connection. Raises InputError if the configuration is invalid: retrying cannot help.
ConnectPolicy = Callable[[ZenohConfig], ConnectOnce | ConnectOnFreePort | ConnectWithRetry]


def _open_logged_session(config: ZenohConfig) -> zenoh.Session:
    session = open_session(config)
    log_connections(session)
    return session


def log_connections(session: zenoh.Session) -> None:
    """Log each connection and its end at level INFO, with its certificate's common name."""
    session.info.declare_link_events_listener(_log_link_event, history=True)


def _log_link_event(event: zenoh.LinkEvent) -> None:
    link = event.link
    change = "connected" if event.kind == zenoh.SampleKind.PUT else "disconnected"
    # The name comes from outside: it must not write lines of its own.
    name = "".join(c if c.isprintable() else "?" for c in link.auth_identifier or "unauthenticated")
    logger.info("zenoh: %s, %s: %s", name[:_MAX_NAME_CHARS], link.dst, change)


def _describe(config: ZenohConfig) -> str:
    return f"{', '.join(session_endpoints(config))} (kinect-vo listen)"


def _open_on_free_port(config: ZenohConfig) -> tuple[zenoh.Session, str]:
    """Open a session on a free port; return it and its endpoint. Raises ZenohUnavailableError."""
    for _ in range(MAX_PORT_ATTEMPTS - 1):
        endpoint = _free_endpoint()
        with suppress(ZenohPortInUseError):
            return open_session(replace(config, listen=(endpoint,))), endpoint
    endpoint = _free_endpoint()
    return open_session(replace(config, listen=(endpoint,))), endpoint


def _free_endpoint() -> str:
    """Return an endpoint with a free port; with port 0, Zenoh would not report its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


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
