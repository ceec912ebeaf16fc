"""Endpoints of Zenoh, such as tcp/127.0.0.1:7450: where settings name them, what they say."""

import ipaddress
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import build_zenoh_config

# Settings of the link may follow: tls/robot1.local:7451?rel=1#iface=eth0.
_ENDPOINT = re.compile(
    r"(?P<protocol>[\w-]+)/(?P<host>\[[^\]]+\]|[^:\[\]?#]+):(?P<port>[0-9]{1,5})(\?.*)?(#.*)?"
)


@dataclass(frozen=True)
class Endpoint:
    """PROTOCOL/HOST:PORT, taken apart."""

    protocol: str
    host: str
    port: str

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The host as an address; None for a name."""
        try:
            return ipaddress.ip_address(self.host)
        except ValueError:
            return None

    def matches(self, locator: "Endpoint") -> bool:
        """Whether a link to this locator, an address, may be the link to this endpoint.

        A name is not looked up: that can take seconds. Protocol and port must do.
        """
        if (self.protocol, self.port) != (locator.protocol, locator.port):
            return False
        return self.address is None or self.address == locator.address


def parse_endpoint(text: str) -> Endpoint:
    """Take an endpoint or a locator apart; what comes behind the port is left out.

    What has no host and port, such as a pipe, is all protocol.
    """
    found = _ENDPOINT.fullmatch(text)
    if found is None:
        return Endpoint(text, "", "")
    return Endpoint(found["protocol"], found["host"].strip("[]"), found["port"])


def configured_endpoints(settings: zenoh.Config, key: str) -> list[str]:
    """The endpoints under `key`: "listen" or "connect"."""
    mode = json.loads(settings.get_json("mode"))
    return _flatten_endpoints(json.loads(settings.get_json(f"{key}/endpoints")), mode)


def _flatten_endpoints(endpoints: Any, mode: str) -> list[str]:
    """Zenoh also takes one list for each mode, and groups of endpoints."""
    if isinstance(endpoints, dict):
        return _flatten_endpoints(endpoints.get(mode, []), mode)
    if isinstance(endpoints, str):
        return [endpoints]
    return [text for part in endpoints or [] for text in _flatten_endpoints(part, mode)]


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
