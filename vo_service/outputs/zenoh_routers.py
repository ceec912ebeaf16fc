"""The endpoints of a session: which it has, and which routers (or peers) are there."""

from collections.abc import Iterable

import zenoh

from vo_service.outputs.zenoh_endpoints import endpoints_in, parse_endpoint
from vo_service.outputs.zenoh_session import session_settings
from vo_service.settings import ZenohConfig


def connect_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where a session with this configuration connects to. Raises InputError."""
    return tuple(endpoints_in(session_settings(config), "connect"))


def named_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where a session listens and connects, by its configuration. Raises InputError."""
    settings = session_settings(config)
    return (*endpoints_in(settings, "listen"), *endpoints_in(settings, "connect"))


def is_connected(session: zenoh.Session, endpoints: Iterable[str]) -> bool:
    """Whether there is a link to any of the endpoints. Takes some 50 microseconds."""
    locators = [parse_endpoint(link.dst) for link in session.info.links()]
    wanted = [parse_endpoint(endpoint) for endpoint in endpoints]
    return any(endpoint.is_at(locator) for endpoint in wanted for locator in locators)
