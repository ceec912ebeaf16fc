"""Which of the routers (or peers) that a session connects to are there."""

import ipaddress
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from vo_service.outputs.zenoh_session import ZenohConfig, session_settings

_ENDPOINT = re.compile(r"(?P<protocol>\w+)/(?P<host>\[[^\]]*\]|[^:?#]*)(:(?P<port>\d+))?")


@dataclass(frozen=True)
class Endpoint:
    """PROTOCOL/HOST:PORT, taken apart."""

    protocol: str
    host: str
    port: str

    def is_at(self, locator: "Endpoint") -> bool:
        """Whether a link to this locator, an address, may be the link to this endpoint.

        A name is not looked up: that can take seconds. Protocol and port must do.
        """
        if (self.protocol, self.port) != (locator.protocol, locator.port):
            return False
        address = _address(self.host)
        return address is None or address == _address(locator.host)


def parse_endpoint(text: str) -> Endpoint:
    """Take an endpoint or a locator apart; what comes behind the port is left out."""
    found = _ENDPOINT.match(text)
    if found is None:
        return Endpoint(text, "", "")
    return Endpoint(found["protocol"], found["host"].strip("[]"), found["port"] or "")


def connect_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where a session with this configuration connects to. Raises InputError."""
    settings = session_settings(config)
    mode = json.loads(settings.get_json("mode"))
    return tuple(_texts(json.loads(settings.get_json("connect/endpoints")), mode))


def is_connected(session: zenoh.Session, endpoints: Iterable[str]) -> bool:
    """Whether there is a link to any of the endpoints. Takes some 50 microseconds."""
    locators = [parse_endpoint(link.dst) for link in session.info.links()]
    wanted = [parse_endpoint(endpoint) for endpoint in endpoints]
    return any(endpoint.is_at(locator) for endpoint in wanted for locator in locators)


def _texts(endpoints: Any, mode: str) -> list[str]:
    """Zenoh also takes one list for each mode, and groups of endpoints."""
    if isinstance(endpoints, dict):
        return _texts(endpoints.get(mode, []), mode)
    if isinstance(endpoints, str):
        return [endpoints]
    return [text for part in endpoints or [] for text in _texts(part, mode)]


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None
