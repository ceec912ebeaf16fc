"""The endpoints of a session: which it has, and which routers (or peers) are there."""

from collections.abc import Iterable

import zenoh

from vo_service.outputs.zenoh_endpoints import configured_endpoints, parse_endpoint
from vo_service.outputs.zenoh_session import build_zenoh_config
from vo_service.settings import ZenohConfig


def connect_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where a session with this configuration connects to. Raises InputError."""
    return tuple(configured_endpoints(build_zenoh_config(config), "connect"))


def session_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where a session listens and connects, by its configuration. Raises InputError."""
    settings = build_zenoh_config(config)
    return (*configured_endpoints(settings, "listen"), *configured_endpoints(settings, "connect"))


def is_connected_to_any(session: zenoh.Session, endpoints: Iterable[str]) -> bool:
    """Whether there is a link to any of the endpoints. Takes some 50 microseconds."""
    locators = [parse_endpoint(link.dst) for link in session.info.links()]
    wanted = [parse_endpoint(endpoint) for endpoint in endpoints]
    return any(endpoint.matches(locator) for endpoint in wanted for locator in locators)
