"""Ways to come to a Zenoh session: at once or not at all, on any port, whenever it can be had."""

import logging
import socket
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

import zenoh

from drivers.core.errors import UserFacingError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.endpoints import (
    connect_endpoints,
    is_connected_to_any,
    session_endpoints,
)
from vo_service.outputs.zenoh.session import (
    ZenohPortInUseError,
    ZenohUnavailableError,
    open_session,
)

logger = logging.getLogger(__name__)

RETRY_S = 2.0
# A router may take this long to take us up before we complain.
ROUTER_GRACE_S = 3.0
# How often a free port is looked for, as somebody else may take it before Zenoh has it.
MAX_PORT_ATTEMPTS = 5


class ZenohConnection(Protocol):
    """Where the session comes from. All is called from one thread, once it has been made."""

    @property
    def warning(self) -> str:
        """What is wrong, one clause; "" while all is well."""
        ...

    @property
    def description(self) -> str:
        """The session's endpoints, and how to listen there: for a person."""
        ...

    def sessions(self) -> list[zenoh.Session]:
        """The open session, or none; may take the second or two that opening takes."""
        ...


# Raises InputError for what is wrong for good.
ConnectPolicy = Callable[[ZenohConfig], ZenohConnection]


class ConnectOnce:
    """For a program that somebody watches: what cannot be opened now is an error."""

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Raises InputError or ZenohNotNowError."""
        self._session = open_session(config)
        self.description = _describe(config)

    def sessions(self) -> list[zenoh.Session]:
        """The session, open or (later) closed."""
        return [self._session]


class ConnectOnFreePort:
    """For a replay: a free port of this computer where the default one is taken.

    Where the user has set another endpoint, or Zenoh's configuration, a taken port is an error.
    """

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Raises InputError or ZenohNotNowError."""
        try:
            self._session = open_session(config)
            self.description = _describe(config)
        except ZenohPortInUseError:
            if config.listen != (DEFAULT_ENDPOINT,) or config.config_file is not None:
                raise
            self._session, endpoint = _open_on_free_port(config)
            self.description = (
                f"{endpoint}, as {DEFAULT_ENDPOINT} is taken (kinect-vo listen --connect "
                f"{endpoint})"
            )

    def sessions(self) -> list[zenoh.Session]:
        """The session, open or (later) closed."""
        return [self._session]


class ConnectWithRetry:
    """For a robot: tries again every two seconds, and says what is wrong as long as it is."""

    def __init__(self, config: ZenohConfig, now_s: Callable[[], float] = time.monotonic) -> None:
        """Raises InputError where trying again would not help."""
        self._config = config
        self._now_s = now_s
        self.description = _describe(config)
        self._routers = _RouterMonitor(connect_endpoints(config), now_s)
        self._opened: list[zenoh.Session] = []
        self._tried_s = now_s()
        self.warning = ""
        try:
            self._opened = [open_session(config)]
        except ZenohUnavailableError as error:
            self._set_warning(f"{error.clause}; trying again")

    def sessions(self) -> list[zenoh.Session]:
        """The open session, or none. Looks after what is wrong, so to be called now and then."""
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
            self._opened = [open_session(self._config)]
        except ZenohUnavailableError as error:
            self._set_warning(f"{error.clause}; trying again")
        except UserFacingError as error:  # a file that was there at the start
            self._set_warning(f"{error}; trying again")
        self._tried_s = self._now_s()

    def _set_warning(self, problem: str) -> None:
        """Keep the warning, and log it when it changes."""
        warning = f"zenoh: {problem}" if problem else ""
        if warning == self.warning:
            return
        self.warning = warning
        logger.warning("%s", warning or "zenoh: all is well again")


def _describe(config: ZenohConfig) -> str:
    return f"{', '.join(session_endpoints(config))} (kinect-vo listen)"


def _open_on_free_port(config: ZenohConfig) -> tuple[zenoh.Session, str]:
    """A session on a port that the kernel names, and its endpoint. Raises ZenohNotNowError."""
    for _ in range(MAX_PORT_ATTEMPTS - 1):
        endpoint = _free_endpoint()
        with suppress(ZenohPortInUseError):
            return open_session(replace(config, listen=(endpoint,))), endpoint
    endpoint = _free_endpoint()
    return open_session(replace(config, listen=(endpoint,))), endpoint


def _free_endpoint() -> str:
    """One that was free a moment ago: given port 0, Zenoh does not say which port it has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class _RouterMonitor:
    """Complains while none of the routers is there."""

    def __init__(self, endpoints: Iterable[str], now_s: Callable[[], float]) -> None:
        self._endpoints = tuple(endpoints)
        self._now_s = now_s
        self._last_connected_s = now_s()

    def warning(self, session: zenoh.Session) -> str:
        """What to tell; "" while a router is there, or none is wanted."""
        if not self._endpoints or is_connected_to_any(session, self._endpoints):
            self._last_connected_s = self._now_s()
        if self._now_s() - self._last_connected_s < ROUTER_GRACE_S:
            return ""
        where = " or ".join(self._endpoints)
        return f"no connection to {where}: it is away or refuses us; trying again"
