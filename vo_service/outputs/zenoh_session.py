"""Opening a Zenoh session with settings that expose nothing, and errors that a person can read."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import zenoh

from drivers.errors import InputError, UserFacingError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7450"


@dataclass(frozen=True)
class ZenohConfig:
    """How poses go out.

    prefix          first part of every key: `{prefix}/odom`, `{prefix}/status`, `{prefix}/alive`
    listen          endpoints that others connect to; loopback alone unless told otherwise
    connect         endpoints (a router, another peer) that this session connects to
    config_file     a Zenoh configuration (JSON5), for TLS and access control. What it leaves at
                    Zenoh's own default is set as without it: `listen`, `connect`, no scouting
    odom_frame_id   frame of the poses
    child_frame_id  frame that moves

    Raises InputError for a prefix that is none.
    """

    prefix: str = "kinect"
    listen: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    connect: tuple[str, ...] = ()
    config_file: Path | None = None
    odom_frame_id: str = "odom"
    child_frame_id: str = "base_link"

    def __post_init__(self) -> None:
        check_prefix(self.prefix)


def check_prefix(prefix: str) -> str:
    """The prefix itself. Raises InputError unless plain names separated by ``/``."""
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise InputError(
            f"zenoh prefix {prefix!r}: use names of letters, digits, '_', '-', '.' separated by "
            "single slashes, without a slash at either end, such as robot1/kinect"
        )
    return prefix


def open_session(config: ZenohConfig) -> zenoh.Session:
    """Open a session: a peer that listens and connects only where `config` says.

    Raises InputError for an endpoint or a configuration file that is wrong, UserFacingError where
    the port is taken.
    """
    settings = _session_settings(config)
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        endpoints = ", ".join(config.listen + config.connect)
        if "Address already in use" in str(error):
            raise UserFacingError(
                f"zenoh cannot listen on {_busy_endpoint(str(error), endpoints)}: the port is "
                "taken, probably by another kinect-vo; stop that one, set zenoh.listen to a free "
                "port, or use --no-publish"
            ) from error
        raise InputError(f"zenoh cannot use {endpoints}: {_plain(error)}") from error


def _session_settings(config: ZenohConfig) -> zenoh.Config:
    """The file's settings, and ours wherever it leaves Zenoh's default.

    Zenoh's defaults listen on every interface and let any session in the network connect.
    Shared memory needs rights that a hardened service does not have, for nothing at our sizes.
    """
    zenoh_default = zenoh.Config()
    settings = _read_file(config.config_file)
    ours: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(config.listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(config.connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }
    for key, value in ours.items():
        if settings.get_json(key) == zenoh_default.get_json(key):
            _insert(settings, key, value)
    return settings


def _read_file(path: Path | None) -> zenoh.Config:
    if path is None:
        return zenoh.Config()
    try:
        return zenoh.Config.from_json5(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the Zenoh configuration: {error}") from error
    except zenoh.ZError as error:
        raise InputError(f"{path}: not a Zenoh configuration: {_plain(error)}") from error


def _insert(settings: zenoh.Config, key: str, value: object) -> None:
    try:
        settings.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise InputError(
            f"zenoh.{key.split('/')[0]} = {json.dumps(value)}: an endpoint is written "
            f"PROTOCOL/ADDRESS:PORT, such as {DEFAULT_ENDPOINT}"
        ) from error


def _busy_endpoint(text: str, otherwise: str) -> str:
    found = re.search(r"bound to (\S+):", text)
    return found.group(1) if found else otherwise


def _plain(error: zenoh.ZError) -> str:
    """Zenoh's message in one line, without the places in its source."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    quoted = re.search(r'msg: "(.*?)", location', text)
    return " ".join((quoted.group(1) if quoted else text).split())
