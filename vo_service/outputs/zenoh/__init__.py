"""Output of poses over Zenoh.

Here: the opening of a session: addresses, who can reach them, the file of Zenoh's own options,
readable errors.
"""

import ipaddress
import json
import logging
import os
import re
import resource
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from drivers.core import InputError, UserFacingError
from drivers.core.config import FieldError
from drivers.core.input_files import open_input, read_input_text
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig

logger = logging.getLogger(__name__)

# Link settings may follow: tls/robot1.local:7451?rel=1#iface=eth0.
_ENDPOINT = re.compile(
    r"(?P<protocol>[\w-]+)/(?P<host>\[[^\]]+\]|[^:\[\]?#]+):(?P<port>[0-9]{1,5})(\?.*)?(#.*)?"
)
ENCRYPTED_PROTOCOLS = ("tls", "quic")
# Keys of a Zenoh configuration that hold file names.
_FILE_KEYS = (
    "transport/link/tls/root_ca_certificate",
    "transport/link/tls/listen_private_key",
    "transport/link/tls/listen_certificate",
    "transport/link/tls/connect_private_key",
    "transport/link/tls/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)
# What comes in: poses and commands have a few kilobytes. Zenoh's own limit is a gigabyte.
MAX_MESSAGE_BYTES = 1 << 20
# Largest message of a frame: points of every pixel have 5 MB.
MAX_FRAME_MESSAGE_BYTES = 8 << 20
# The kernel's default holds megabytes of images, and poses behind them wait on a narrow link.
_SEND_BUFFER_BYTES = 128 << 10
# Zenoh locks shared memory, at most this much for one publisher.
_LOCKED_BYTES = 8_000_000
_CLIENT_CONNECT_TIMEOUT_MS = 2000
_MAX_NAME_CHARS = 64


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
        endpoints: The endpoints.
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


def read_zenoh_config(path: Path) -> zenoh.Config:
    """Read a Zenoh configuration (JSON5) and make its file names absolute.

    A relative name is searched in systemd's credentials (``$CREDENTIALS_DIRECTORY``), then in the
    folder of the configuration.

    Raises:
        InputError: The configuration or one of its files cannot be read.
    """
    try:
        settings = zenoh.Config.from_json5(read_input_text(path, "name a JSON5 file"))
    except zenoh.ZError as error:
        raise InputError(
            f"{path}{_line_and_reason(str(error))}; compare it with the examples in config/zenoh"
        ) from error
    for key in _FILE_KEYS:
        name = json.loads(settings.get_json(key))
        if name:
            settings.insert_json5(key, json.dumps(str(_resolve_file(name, path, key))))
    return settings


def _line_and_reason(text: str) -> str:
    """Extract `:LINE: reason` from Zenoh's message, which spans several lines for syntax errors."""
    syntax_error = re.search(r"--> (\d+):\d+.*= (.*)", text, re.DOTALL)
    if syntax_error:
        return f":{syntax_error[1]}: not JSON5: {syntax_error[2].strip()}"
    return f": not a Zenoh configuration: {' '.join(text.split())}"


def _resolve_file(name: str, config: Path, key: str) -> Path:
    """Return the file's absolute path. Raises InputError unless it is readable."""
    folders = [config.parent.absolute()]
    if credentials := os.environ.get("CREDENTIALS_DIRECTORY"):
        folders.insert(0, Path(credentials))
    candidates = [folder / name for folder in folders]  # `name` itself if it is absolute
    file = next((path for path in candidates if path.exists()), candidates[-1])
    try:
        open_input(file).close()
    except OSError as error:
        searched = " or ".join(dict.fromkeys(str(path.parent) for path in candidates))
        raise InputError(
            f"{config}: {key.replace('/', '.')} = {json.dumps(name)}: {error.strerror} in "
            f"{searched}; put a file there that this user may read, or create it with kinect-vo "
            "certificates"
        ) from error
    return file


class ZenohUnavailableError(UserFacingError):
    """Zenoh cannot listen or connect now, but retrying may help.

    Attributes:
        clause: What fails, without advice.
        advice: What the user can do.
    """

    def __init__(self, clause: str, advice: str) -> None:
        super().__init__(f"zenoh {clause}; {advice}")
        self.clause, self.advice = clause, advice


class ZenohPortInUseError(ZenohUnavailableError):
    """Another program listens on the port."""


def open_session(config: ZenohConfig, max_message_bytes: int = MAX_MESSAGE_BYTES) -> zenoh.Session:
    """Open a session that listens on and connects to only the configured endpoints.

    Returns within a few seconds. Without access to shared memory, it goes without.

    Args:
        config: Endpoints, or the configuration file that holds them.
        max_message_bytes: Larger messages that come in are discarded, unless the file says
            otherwise.

    Raises:
        InputError: An endpoint or the configuration file is invalid.
        ZenohUnavailableError: The session cannot open now, but retrying may help.
        ZenohPortInUseError: Another program listens on the port.
    """
    settings = build_zenoh_config(config, max_message_bytes)
    for key in ("listen", "connect"):
        limited = [_limit_send_buffer(text) for text in configured_endpoints(settings, key)]
        settings.insert_json5(f"{key}/endpoints", json.dumps(limited))
    try:
        return open_with_shared_memory(settings)
    except zenoh.ZError as error:
        endpoints = ", ".join(config.listen + config.connect)
        for marker, (error_type, clause, advice) in _TRANSIENT_ERRORS.items():
            if marker in str(error):
                endpoint = _endpoint_in_error(str(error)) or endpoints
                own, alternative = "zenoh.listen", ", or use --no-publish"
                if not config.listen:  # a router, whose file has the addresses
                    own, alternative = f"listen.endpoints in {config.config_file}", ""
                advice = advice.format(listen=own, alternative=alternative)
                raise error_type(clause.format(endpoint), advice) from error
        raise InputError(f"zenoh cannot use {endpoints}: {_format_error(error)}") from error


def log_connections(session: zenoh.Session) -> None:
    """Log each connection and its end at level INFO, with its certificate's common name."""
    session.info.declare_link_events_listener(_log_link_event, history=True)


def _log_link_event(event: zenoh.LinkEvent) -> None:
    link = event.link
    change = "connected" if event.kind == zenoh.SampleKind.PUT else "disconnected"
    # The name comes from outside: it must not write lines of its own.
    name = "".join(c if c.isprintable() else "?" for c in link.auth_identifier or "unauthenticated")
    logger.info("zenoh: %s, %s: %s", name[:_MAX_NAME_CHARS], link.dst, change)


def open_with_shared_memory(settings: zenoh.Config) -> zenoh.Session:
    """Open a session; without shared memory if it cannot be had. Raises ZError."""
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:  # a read-only /dev/shm, or a process without the right
        if "shm" not in str(error):
            raise
        logger.info("zenoh: no shared memory: %s", _format_error(error))
        settings.insert_json5("transport/shared_memory/enabled", "false")
        return zenoh.open(settings)


def _may_lock_memory() -> bool:
    """Whether this process may map a publisher's pool; if not, it would receive no images."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return limit == resource.RLIM_INFINITY or limit >= _LOCKED_BYTES


def _limit_send_buffer(endpoint: str) -> str:
    """Add the size of the kernel's send buffer to an endpoint over TCP that does not set it."""
    if endpoint.partition("/")[0] not in ("tcp", "tls") or "so_sndbuf" in endpoint:
        return endpoint
    separator = ";" if "#" in endpoint else "#"
    return f"{endpoint}{separator}so_sndbuf={_SEND_BUFFER_BYTES}"


# Errors that may go away by themselves, by a part of Zenoh's message.
_TRANSIENT_ERRORS = {
    "Address already in use": (
        ZenohPortInUseError,
        "cannot listen on {}: the port is in use, probably by another kinect-vo",
        "stop the other one, set {listen} to a free port{alternative}",
    ),
    "Cannot assign requested address": (
        ZenohUnavailableError,
        "cannot listen on {}: this computer does not have that address now",
        "set {listen} to an address that it has",
    ),
    "failed to lookup address": (
        ZenohUnavailableError,
        "cannot listen on {}: the name has no address now",
        "set {listen} to an address of this computer",
    ),
    "Unable to connect to any": (
        ZenohUnavailableError,
        "cannot connect to {}: no reply",
        "start the router, or correct connect.endpoints in the Zenoh configuration",
    ),
}


def build_zenoh_config(
    config: ZenohConfig, max_message_bytes: int = MAX_MESSAGE_BYTES
) -> zenoh.Config:
    """Build Zenoh's configuration: the file's settings, with safe defaults for all others.

    Zenoh's own defaults listen on every interface and accept any session of the network. Shared
    memory is only for payloads that are placed in it.

    Raises:
        InputError: An endpoint or the configuration file is invalid.
    """
    zenoh_default = zenoh.Config()
    settings = read_zenoh_config(config.config_file) if config.config_file else zenoh.Config()
    ours: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(config.listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(config.connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": _may_lock_memory(),
        "transport/shared_memory/transport_optimization/enabled": False,
        "timestamping/enabled": True,  # for the cache of /tf_static
        # A whole raw image fits into the queue, so that only a slow reader loses it.
        "transport/link/tx/queue/size/background": 16,
        "transport/link/rx/max_message_size": max_message_bytes,
        # Zenoh's default of two loses poses now and then if many are sent at once.
        "transport/link/tx/queue/size/real_time": 16,
    }
    for key, value in ours.items():
        if settings.get_json(key) == zenoh_default.get_json(key):
            _set_value(settings, key, value)
    if settings.get_json("mode") == '"client"':
        # A client waits for its router while it opens; the default waits forever.
        settings.insert_json5("connect/timeout_ms", json.dumps(_CLIENT_CONNECT_TIMEOUT_MS))
    return settings


def _set_value(settings: zenoh.Config, key: str, value: object) -> None:
    try:
        settings.insert_json5(key, json.dumps(value))
    except zenoh.ZError:
        # Zenoh's error names its own source files.
        name = key.split("/")[0]
        text = str(_endpoint_error(f"zenoh.{name} = {json.dumps(value)}"))
        raise FieldError(("zenoh", name), text) from None


def check_endpoint(endpoint: str) -> None:
    """Raise InputError if a client's parameter `connect` is not an endpoint."""
    try:
        zenoh.Config().insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise _endpoint_error(f"connect = {endpoint!r}") from None


def _endpoint_error(setting: str) -> InputError:
    return InputError(
        f"{setting}: an endpoint is written PROTOCOL/ADDRESS:PORT, such as {DEFAULT_ENDPOINT}"
    )


def _endpoint_in_error(text: str) -> str:
    """Extract the endpoint from Zenoh's message; "" if it has none."""
    match = re.search(r"bound to (\S+):|\((\w+/\S+?)\)", text)
    endpoint = (match.group(1) or match.group(2)) if match else ""
    return re.sub(r"[#;]so_sndbuf=\d+", "", endpoint)  # not the user's


def _format_error(error: zenoh.ZError) -> str:
    """Format Zenoh's message as one line, without its source locations."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    quoted = re.search(r'msg: "(.*?)", location', text)
    return " ".join((quoted.group(1) if quoted else text).split())
