"""Whether a Zenoh session could be opened with its settings, found out without the network."""

import ipaddress
import json
import re

import zenoh

from drivers.errors import InputError
from vo_service.outputs.zenoh_key_check import ENCRYPTED, check_keys, has_client_certificates
from vo_service.outputs.zenoh_session import DEFAULT_ENDPOINT, ZenohConfig, session_settings

_PLAIN = ("tcp", "udp", "ws")
_BY_PATH = ("unixsock-stream", "unixpipe", "serial", "vsock")
_ENDPOINT = re.compile(r"(?P<protocol>[\w-]+)/(?P<host>\[[^\]]+\]|[^:\[\]]+):(?P<port>\d{1,5})")


def check_zenoh(config: ZenohConfig) -> str:
    """Check the file, its keys, its rules and the endpoints; nothing listens or connects.

    Returns what is allowed but dangerous, one clause, or "". Raises InputError for what is wrong.
    """
    settings = session_settings(config)
    where = str(config.config_file or "zenoh")
    listen, connect = (_endpoints(settings, key) for key in ("listen", "connect"))
    for endpoint in (*listen, *connect):
        _check_endpoint(endpoint, where)
    check_keys(settings, where, listen, connect)
    _check_rules(settings, where)
    is_safe = ENCRYPTED if has_client_certificates(settings) else ()
    exposed = [
        endpoint
        for endpoint in listen
        if _is_for_the_network(endpoint) and endpoint.partition("/")[0] not in is_safe
    ]
    if not exposed:
        return ""
    return f"{where}: anyone in the network may connect to {', '.join(exposed)}; docs/security.md"


def listening(settings: zenoh.Config) -> list[str]:
    """Where a session with these settings listens."""
    return _endpoints(settings, "listen")


def _endpoints(settings: zenoh.Config, key: str) -> list[str]:
    """Zenoh also takes one list for each mode, and groups of endpoints."""
    found = json.loads(settings.get_json(f"{key}/endpoints"))
    if isinstance(found, dict):
        found = found.get(json.loads(settings.get_json("mode")), [])
    return [text for part in found for text in ([part] if isinstance(part, str) else part)]


def _check_endpoint(endpoint: str, where: str) -> None:
    protocol = endpoint.partition("/")[0]
    if protocol in _BY_PATH:
        return
    found = _ENDPOINT.match(endpoint)
    if found is None or protocol not in (*_PLAIN, *ENCRYPTED) or int(found["port"]) > 65535:
        raise InputError(
            f"{where}: {json.dumps(endpoint)} is no endpoint; write PROTOCOL/ADDRESS:PORT, such as "
            f"{DEFAULT_ENDPOINT} or tls/robot1.local:7451"
        )


def _is_for_the_network(endpoint: str) -> bool:
    found = _ENDPOINT.match(endpoint)
    if found is None:
        return False  # a pipe, a socket in the file system
    host = found["host"].strip("[]")
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def _check_rules(settings: zenoh.Config, where: str) -> None:
    """Have Zenoh itself read its rules, in a session that neither listens nor connects."""
    for key, value in (("mode", '"peer"'), ("listen/endpoints", "[]"), ("connect/endpoints", "[]")):
        settings.insert_json5(key, value)
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        settings.insert_json5(key, "false")
    try:
        zenoh.open(settings).close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        reason = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
        plain = " ".join(reason.split()).removeprefix("Access control not enabled due to: ")
        raise InputError(f"{where}: {plain}; mend it there") from error
