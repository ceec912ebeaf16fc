"""A Zenoh session that is had as soon as it can be."""

import logging
import threading
from collections.abc import Callable

import zenoh

from drivers.core.errors import UserFacingError
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import ZenohUnavailableError, open_session

logger = logging.getLogger(__name__)

RETRY_S = 1.0


class BackgroundConnection:
    """Opens a session; where nobody is there to open it with, tries again in the background.

    A Zenoh peer opens alone and meets the others later. A Zenoh client, which readers of a network
    with TLS are, opens together with its router or service, or not at all.
    """

    def __init__(self, config: ZenohConfig, on_open: Callable[[zenoh.Session], None]) -> None:
        """Calls `on_open` once. Raises InputError for what is wrong for good."""
        self._config = config
        self._on_open = on_open
        self._closed = threading.Event()
        self._sessions: list[zenoh.Session] = []
        self._thread = threading.Thread(
            target=self._retry_until_open, name="connecting", daemon=True
        )
        try:
            self._open()
        except ZenohUnavailableError:
            self._thread.start()

    @property
    def sessions(self) -> list[zenoh.Session]:
        """The session, or none yet."""
        return self._sessions

    def close(self) -> None:
        """Close the session, or give up; may take the two seconds that one more try takes."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        for session in self._sessions:
            session.close()  # type: ignore[no-untyped-call]

    def _retry_until_open(self) -> None:
        """Also past what was in order at the start, such as a key that is being replaced."""
        told = ""
        while not self._sessions and not self._closed.wait(RETRY_S):
            try:
                self._open()
            except ZenohUnavailableError:
                told = ""
            except UserFacingError as error:
                if str(error) != told:
                    logger.warning("%s; trying again", error)
                told = str(error)

    def _open(self) -> None:
        session = open_session(self._config)
        self._on_open(session)
        self._sessions = [session]
