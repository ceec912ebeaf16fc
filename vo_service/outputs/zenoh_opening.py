"""Two ways to come to a Zenoh session: at once or not at all, and whenever it can be had."""

import logging
import time
from collections.abc import Callable, Iterable
from typing import Protocol

import zenoh

from drivers.errors import UserFacingError
from vo_service.outputs.zenoh_routers import connect_endpoints, is_connected
from vo_service.outputs.zenoh_session import ZenohConfig, ZenohNotNowError, open_session

logger = logging.getLogger(__name__)

RETRY_S = 2.0
# A router may take this long to take us up before we complain.
GRACE_S = 3.0


class Opening(Protocol):
    """Where the session comes from. All is called from one thread, once it has been made."""

    @property
    def warning(self) -> str:
        """What is wrong, one clause; "" while all is well."""
        ...

    def sessions(self) -> list[zenoh.Session]:
        """The open session, or none; may take the second or two that opening takes."""
        ...


# Raises InputError for what is wrong for good.
WayToOpen = Callable[[ZenohConfig], Opening]


class OpenAtOnce:
    """For a program that somebody watches: what cannot be opened now is an error."""

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Raises InputError or ZenohNotNowError."""
        self._session = open_session(config)

    def sessions(self) -> list[zenoh.Session]:
        """The session, open or (later) closed."""
        return [self._session]


class KeepTrying:
    """For a robot: tries again every two seconds, and says what is wrong as long as it is."""

    def __init__(self, config: ZenohConfig, now_s: Callable[[], float] = time.monotonic) -> None:
        """Raises InputError where trying again would not help."""
        self._config = config
        self._now_s = now_s
        self._routers = _RouterWatch(connect_endpoints(config), now_s)
        self._opened: list[zenoh.Session] = []
        self._tried_s = now_s()
        self.warning = ""
        try:
            self._opened = [open_session(config)]
        except ZenohNotNowError as error:
            self._tell(f"{error.clause}; trying again")

    def sessions(self) -> list[zenoh.Session]:
        """The open session, or none. Looks after what is wrong, so to be called now and then."""
        if not self._opened or self._opened[0].is_closed():
            self._opened = []
            self._try_again()
        for session in self._opened:
            self._tell(self._routers.complaint(session))
        return self._opened

    def _try_again(self) -> None:
        if self._now_s() - self._tried_s < RETRY_S:
            return
        try:
            self._opened = [open_session(self._config)]
        except ZenohNotNowError as error:
            self._tell(f"{error.clause}; trying again")
        except UserFacingError as error:  # a file that was there at the start
            self._tell(f"{error}; trying again")
        self._tried_s = self._now_s()

    def _tell(self, problem: str) -> None:
        """Keep the warning, and log it when it changes."""
        warning = f"zenoh: {problem}" if problem else ""
        if warning == self.warning:
            return
        self.warning = warning
        logger.warning("%s", warning or "zenoh: all is well again")


class _RouterWatch:
    """Complains while none of the routers is there."""

    def __init__(self, endpoints: Iterable[str], now_s: Callable[[], float]) -> None:
        self._endpoints = tuple(endpoints)
        self._now_s = now_s
        self._there_s = now_s()

    def complaint(self, session: zenoh.Session) -> str:
        """What to tell; "" while a router is there, or none is wanted."""
        if not self._endpoints or is_connected(session, self._endpoints):
            self._there_s = self._now_s()
        if self._now_s() - self._there_s < GRACE_S:
            return ""
        where = " or ".join(self._endpoints)
        return f"no connection to {where}: it is away or refuses us; trying again"
