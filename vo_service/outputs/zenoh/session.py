"""Opening a Zenoh session with settings that expose nothing, and errors that a person can read."""

import json
import re

import zenoh

from drivers.core.errors import InputError, UserFacingError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.config_file import read_zenoh_config

# Ours are some kilobytes. Zenoh's own limit is a gigabyte.
MAX_MESSAGE_BYTES = 1 << 20
_CLIENT_CONNECT_TIMEOUT_MS = 2000


class ZenohUnavailableError(UserFacingError):
    """Zenoh cannot listen or connect now; trying again later may help. `clause` says what fails."""

    def __init__(self, clause: str, advice: str) -> None:
        super().__init__(f"zenoh {clause}; {advice}")
        self.clause = clause


class ZenohPortInUseError(ZenohUnavailableError):
    """Somebody else listens on the port."""


def open_session(config: ZenohConfig) -> zenoh.Session:
    """Open a session: a peer that listens and connects only where `config` says.

    Returns within a few seconds. Raises InputError for an endpoint or a configuration file that is
    wrong, ZenohNotNowError for what time may mend: ZenohPortTakenError for a port that is taken.
    """
    settings = build_zenoh_config(config)
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        endpoints = ", ".join(config.listen + config.connect)
        for sign, (kind, clause, advice) in _TRANSIENT_ERRORS.items():
            if sign in str(error):
                where = _endpoint_in_error(str(error)) or endpoints
                raise kind(clause.format(where), advice) from error
        raise InputError(f"zenoh cannot use {endpoints}: {_format_error(error)}") from error


# What time may mend, by Zenoh's own words.
_TRANSIENT_ERRORS = {
    "Address already in use": (
        ZenohPortInUseError,
        "cannot listen on {}: the port is taken, probably by another kinect-vo",
        "stop that one, set zenoh.listen to a free port, or use --no-publish",
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
        "cannot connect to {}: nobody answers there",
        "start the router, or mend connect.endpoints in the Zenoh configuration",
    ),
}


def build_zenoh_config(config: ZenohConfig) -> zenoh.Config:
    """The file's settings, and ours wherever it leaves Zenoh's default.

    Zenoh's defaults listen on every interface and let any session in the network connect.
    Shared memory needs rights that a hardened service does not have, for nothing at our sizes.
    Larger messages than any of ours are thrown away as they come in. Raises InputError.
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
        # Zenoh's two are lost now and then where many poses leave at once.
        "transport/link/tx/queue/size/real_time": 16,
    }
    for key, value in ours.items():
        if settings.get_json(key) == zenoh_default.get_json(key):
            _set_value(settings, key, value)
    if settings.get_json("mode") == '"client"':
        # A client waits for its router while it opens; never for ever.
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
    """The endpoint that Zenoh complains of; "" where it names none."""
    found = re.search(r"bound to (\S+):|\((\w+/\S+?)\)", text)
    return (found.group(1) or found.group(2)) if found else ""


def _format_error(error: zenoh.ZError) -> str:
    """Zenoh's message in one line, without the places in its source."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    quoted = re.search(r'msg: "(.*?)", location', text)
    return " ".join((quoted.group(1) if quoted else text).split())
