"""Addresses that a Zenoh session listens on and connects to, and who can reach them."""

import ipaddress
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import zenoh

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.zenoh_config import build_zenoh_config, endpoint_error

# Link settings may follow: tls/robot1.local:7451?rel=1#iface=eth0.
_ENDPOINT = re.compile(
    r"(?P<protocol>[\w-]+)/(?P<host>\[[^\]]+\]|[^:\[\]?#]+):(?P<port>[0-9]{1,5})(\?.*)?(#.*)?"
)
ENCRYPTED_PROTOCOLS = ("tls", "quic")
_UNENCRYPTED = ("tcp", "udp", "ws")
# The one protocol without a port that the Python package of Zenoh has.
_SOCKET_FILE_PROTOCOL = "unixsock-stream"


@dataclass(frozen=True)
class Endpoint:
    """A parsed endpoint, PROTOCOL/HOST:PORT."""

    protocol: str
    host: str
    port: str

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The host as an IP address; None for a name."""
        try:
            return ipaddress.ip_address(self.host)
        except ValueError:
            return None

    def matches(self, locator: "Endpoint") -> bool:
        """Return whether a link to this locator may be the link to this endpoint.

        A host name is not resolved, as that can take seconds; then protocol and port must match.
        """
        if (self.protocol, self.port) != (locator.protocol, locator.port):
            return False
        return self.address is None or self.address == locator.address


def parse_endpoint(text: str) -> Endpoint:
    """Parse an endpoint or a locator; the part after the port is dropped.

    A text without host and port, such as a pipe, becomes the protocol.
    """
    match = _ENDPOINT.fullmatch(text)
    if match is None:
        return Endpoint(text, "", "")
    return Endpoint(match["protocol"], match["host"].strip("[]"), match["port"])


def is_endpoint(text: str) -> bool:
    """Whether a text has a protocol that Zenoh may use here, and a possible port."""
    if text.partition("/")[0] == _SOCKET_FILE_PROTOCOL:
        return True
    endpoint = parse_endpoint(text)
    return (
        endpoint.protocol in (*_UNENCRYPTED, *ENCRYPTED_PROTOCOLS) and int(endpoint.port) <= 65535
    )


def check_endpoint(endpoint: str) -> None:
    """Raise InputError if a client's parameter `connect` is not an endpoint."""
    if not is_endpoint(endpoint):
        raise endpoint_error(f"connect = {endpoint!r}")


def configured_endpoints(settings: zenoh.Config, key: str) -> list[str]:
    """Return the endpoints under `key`: "listen" or "connect"."""
    mode = json.loads(settings.get_json("mode"))
    return _flatten_endpoints(json.loads(settings.get_json(f"{key}/endpoints")), mode)


def _flatten_endpoints(endpoints: Any, mode: str) -> list[str]:
    """Flatten Zenoh's other forms: one list per mode, and groups of endpoints."""
    if isinstance(endpoints, dict):
        return _flatten_endpoints(endpoints.get(mode, []), mode)
    if isinstance(endpoints, str):
        return [endpoints]
    return [text for part in endpoints or [] for text in _flatten_endpoints(part, mode)]


def connect_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Return the endpoints that a session connects to.

    Raises:
        InputError: If the configuration is not valid.
    """
    return tuple(configured_endpoints(build_zenoh_config(config), "connect"))


def session_endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Return the endpoints that a session listens on and connects to.

    Raises:
        InputError: If the configuration is not valid.
    """
    settings = build_zenoh_config(config)
    return (*configured_endpoints(settings, "listen"), *configured_endpoints(settings, "connect"))


def endpoints_without_roles(config: ZenohConfig) -> list[str]:
    """Return the endpoints in the network over which everybody gets all that is published.

    They are not encrypted or take no certificates, or there are no rules for those who connect.

    Raises:
        InputError: The configuration is not valid.
    """
    settings = build_zenoh_config(config)
    has_certificates = requires_client_certificates(settings)
    has_rules = json.loads(settings.get_json("access_control/enabled")) is True
    listen, connect = (configured_endpoints(settings, key) for key in ("listen", "connect"))
    return [
        *exposed_endpoints(listen, is_encryption_enough=has_certificates and has_rules),
        *exposed_endpoints(connect, is_encryption_enough=True),  # the router has the rules
    ]


def exposed_endpoints(endpoints: Sequence[str], is_encryption_enough: bool) -> list[str]:
    """Return the endpoints in the network that are not protected.

    Args:
        is_encryption_enough: Whether an encrypted endpoint is protected.
    """
    protected = ENCRYPTED_PROTOCOLS if is_encryption_enough else ()
    return [
        text
        for text, endpoint in zip(endpoints, map(parse_endpoint, endpoints), strict=True)
        if _is_network_endpoint(endpoint) and endpoint.protocol not in protected
    ]


def _is_network_endpoint(endpoint: Endpoint) -> bool:
    if not endpoint.host:
        return False  # a pipe, or a socket in the file system
    if endpoint.address is None:
        return endpoint.host != "localhost"
    return not endpoint.address.is_loopback


def requires_client_certificates(settings: zenoh.Config) -> bool:
    """Return whether TLS clients need a certificate."""
    return json.loads(settings.get_json("transport/link/tls/enable_mtls")) is True


def is_connected_to_any(session: zenoh.Session, endpoints: Iterable[str]) -> bool:
    """Return whether there is a link to any of the endpoints. Takes about 50 microseconds."""
    locators = [parse_endpoint(link.dst) for link in session.info.links()]
    wanted = [parse_endpoint(endpoint) for endpoint in endpoints]
    return any(endpoint.matches(locator) for endpoint in wanted for locator in locators)
