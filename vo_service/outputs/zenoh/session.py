"""Opening of a Zenoh session, and what can go wrong with it."""

import json
import logging
import re

import zenoh
import zenoh.ext

from drivers.core import InputError, UserFacingError
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.addresses import configured_endpoints
from vo_service.outputs.zenoh.zenoh_config import MAX_MESSAGE_BYTES, build_zenoh_config

logger = logging.getLogger(__name__)
# The kernel's default holds megabytes of images, and poses behind them wait on a narrow link.
_SEND_BUFFER_BYTES = 128 << 10
_MAX_NAME_CHARS = 64


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
    listen, connect = (configured_endpoints(settings, key) for key in ("listen", "connect"))
    for key, texts in (("listen", listen), ("connect", connect)):
        limited = [_limit_send_buffer(text) for text in texts]
        settings.insert_json5(f"{key}/endpoints", json.dumps(limited))
    try:
        return open_with_shared_memory(settings)
    except zenoh.ZError as error:
        endpoints = ", ".join([*listen, *connect])
        for marker, (error_type, clause, advice) in _TRANSIENT_ERRORS.items():
            if marker in str(error):
                endpoint = _endpoint_in_error(str(error)) or endpoints
                is_of_file = listen != list(config.listen)
                own = f"listen.endpoints in {config.config_file}" if is_of_file else "zenoh.listen"
                alternative = ", or use --no-publish" if config.listen else ""  # "": a router
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


def _endpoint_in_error(text: str) -> str:
    """Extract the endpoint from Zenoh's message; "" if it has none."""
    if match := re.search(r"bound to (\S+):|\((\w+/\S+?)\)", text):
        endpoint = match.group(1) or match.group(2)
        return re.sub(r"[#;]so_sndbuf=\d+", "", endpoint)  # not the user's
    match = re.search(r"new (TLS|TCP) listener on (\S+):", text)
    return f"{match.group(1).lower()}/{match.group(2)}" if match else ""


def _format_error(error: zenoh.ZError) -> str:
    text = without_source_locations(error)
    quoted = re.search(r'msg: "(.*?)", location', text)
    return quoted.group(1) if quoted else text


def without_source_locations(error: zenoh.ZError) -> str:
    """Return Zenoh's message as one line, without the places in its source."""
    return " ".join(re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error)).split())


def declare_latched_publisher(
    session: zenoh.Session, key: str, encoding: zenoh.Encoding | None = None
) -> zenoh.ext.AdvancedPublisher:
    """Declare a publisher that gives its last message to advanced subscribers that come later."""
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        cache=zenoh.ext.CacheConfig(max_samples=1),
        publisher_detection=True,
    )
