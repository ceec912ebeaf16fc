"""A Zenoh session that opens in the background if it cannot open at once."""

import logging
import threading
from collections.abc import Callable

import zenoh

from drivers.core.errors import UserFacingError
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import (
    MAX_MESSAGE_BYTES,
    ZenohUnavailableError,
    open_session,
)

logger = logging.getLogger(__name__)

RETRY_S = 1.0


class BackgroundConnection:
    """Session that is opened at once or, if no router answers, retried in the background.

    A Zenoh peer can open alone and find others later. A Zenoh client, as used with TLS, opens only
    while its router or service is reachable.
    """

    def __init__(
        self,
        config: ZenohConfig,
        on_open: Callable[[zenoh.Session], None],
        max_message_bytes: int = MAX_MESSAGE_BYTES,
    ) -> None:
        """Open the session.

        Args:
            config: Endpoints, or the configuration file that holds them.
            on_open: Called once, with the open session.
            max_message_bytes: Larger messages that come in are discarded.

        Raises:
            InputError: The configuration is invalid, so that retrying cannot help.
        """
        self._config = config
        self._on_open = on_open
        self._max_message_bytes = max_message_bytes
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
        """The open session; empty before it opens."""
        return self._sessions

    def close(self) -> None:
        """Close the session or stop retrying; a retry under way may take two seconds."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        for session in self._sessions:
            session.close()  # type: ignore[no-untyped-call]

    def _retry_until_open(self) -> None:
        """Retry after every error, even for files: a key may be being replaced."""
        last_error = ""
        while not self._sessions and not self._closed.wait(RETRY_S):
            try:
                self._open()
            except ZenohUnavailableError:
                last_error = ""
            except UserFacingError as error:
                if str(error) != last_error:
                    logger.warning("%s; trying again", error)
                last_error = str(error)

    def _open(self) -> None:
        session = open_session(self._config, self._max_message_bytes)
        self._on_open(session)
        self._sessions = [session]
