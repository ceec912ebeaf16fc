"""The connection of a replay: it finds a free port if another program has the usual one."""

from contextlib import suppress
from dataclasses import replace

import zenoh

from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.loopback_ports import LOOPBACK, probe_port
from vo_service.outputs.zenoh.output import describe
from vo_service.outputs.zenoh.session import ZenohPortInUseError, open_session

# Another program may take a free port before Zenoh opens it.
MAX_PORT_ATTEMPTS = 5


class ConnectOnFreePort:
    """Policy for a replay: uses a free local port if the default port is in use.

    If the user has set an endpoint or a Zenoh configuration, a port in use is an error.
    """

    warning = ""

    def __init__(self, config: ZenohConfig) -> None:
        """Open the session. Raises InputError or ZenohUnavailableError."""
        try:
            self._session = open_session(config)
            self.description = describe(config)
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
    return f"tcp/{LOOPBACK}:{probe_port()}"
