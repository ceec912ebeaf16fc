"""Opening of a Zenoh session with safe defaults and readable errors."""

import json
import re

import zenoh

from drivers.core.errors import InputError, UserFacingError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.config_file import read_zenoh_config

# The service's messages have a few kilobytes. Zenoh's own limit is a gigabyte.
MAX_MESSAGE_BYTES = 1 << 20
_CLIENT_CONNECT_TIMEOUT_MS = 2000


class ZenohUnavailableError(UserFacingError):
    """Zenoh cannot listen or connect now, but retrying may help.

    Attributes:
        clause: what fails, without advice.
    """

    def __init__(self, clause: str, advice: str) -> None:
        super().__init__(f"zenoh {clause}; {advice}")
        self.clause = clause


class ZenohPortInUseError(ZenohUnavailableError):
    """Another program listens on the port."""


def open_session(config: ZenohConfig) -> zenoh.Session:
    """Open a session that listens on and connects to only the configured endpoints.

    Returns within a few seconds.

    Raises:
        InputError: an endpoint or the configuration file is invalid.
        ZenohUnavailableError: the session cannot open now, but retrying may help.
        ZenohPortInUseError: another program listens on the port.
    """
    settings = build_zenoh_config(config)
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        endpoints = ", ".join(config.listen + config.connect)
        for marker, (error_type, clause, advice) in _TRANSIENT_ERRORS.items():
            if marker in str(error):
                endpoint = _endpoint_in_error(str(error)) or endpoints
                raise error_type(clause.format(endpoint), advice) from error
        raise InputError(f"zenoh cannot use {endpoints}: {_format_error(error)}") from error


# Errors that may go away by themselves, by a part of Zenoh's message.
_TRANSIENT_ERRORS = {
    "Address already in use": (
        ZenohPortInUseError,
        "cannot listen on {}: the port is in use, probably by another kinect-vo",
        "stop the other one, set zenoh.listen to a free port, or use --no-publish",
    ),
    "Cannot assign requested address": (
        ZenohUnavailableError,
        "cannot listen on {}: this computer does not have that address now",
        "set zenoh.listen to an address that it has",
    ),
    "failed to lookup address": (
        ZenohUnavailableError,
        "cannot listen on {}: the name has no address now",
        "set zenoh.listen to an address of this computer",
    ),
    "Unable to connect to any": (
        ZenohUnavailableError,
        "cannot connect to {}: no reply",
        "start the router, or correct connect.endpoints in the Zenoh configuration",
    ),
}


def build_zenoh_config(config: ZenohConfig) -> zenoh.Config:
    """Build Zenoh's configuration: the file's settings, with safe defaults for all others.

    Zenoh's own defaults listen on every interface and accept any session of the network. Shared
    memory needs rights that a hardened service does not have, and does not help with small
    messages. Incoming messages larger than any of the service's are discarded.

    Raises:
        InputError: an endpoint or the configuration file is invalid.
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
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
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
    except zenoh.ZError as error:
        raise InputError(
            f"zenoh.{key.split('/')[0]} = {json.dumps(value)}: an endpoint is written "
            f"PROTOCOL/ADDRESS:PORT, such as {DEFAULT_ENDPOINT}"
        ) from error


def _endpoint_in_error(text: str) -> str:
    """Extract the endpoint from Zenoh's message; "" if it has none."""
    match = re.search(r"bound to (\S+):|\((\w+/\S+?)\)", text)
    return (match.group(1) or match.group(2)) if match else ""


def _format_error(error: zenoh.ZError) -> str:
    """Format Zenoh's message as one line, without its source locations."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    quoted = re.search(r'msg: "(.*?)", location', text)
    return " ".join((quoted.group(1) if quoted else text).split())
