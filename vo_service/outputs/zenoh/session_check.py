"""Check of a Zenoh configuration without the network."""

import json
import re

import zenoh

from drivers.core.errors import InputError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.session import (
    Endpoint,
    build_zenoh_config,
    configured_endpoints,
    parse_endpoint,
)
from vo_service.outputs.zenoh.tls_check import (
    ENCRYPTED_PROTOCOLS,
    check_tls_keys,
    requires_client_certificates,
)

_UNENCRYPTED = ("tcp", "udp", "ws")
_PATH_PROTOCOLS = ("unixsock-stream", "unixpipe", "serial", "vsock")


def check_session_config(config: ZenohConfig) -> str:
    """Check the file, its keys, its rules and the endpoints, without listening or connecting.

    Returns:
        A warning about allowed but dangerous settings, one clause; "" if there are none.

    Raises:
        InputError: A setting is invalid.
    """
    settings = build_zenoh_config(config)
    where = str(config.config_file or "zenoh")
    listen, connect = (configured_endpoints(settings, key) for key in ("listen", "connect"))
    for endpoint in (*listen, *connect):
        _check_endpoint(endpoint, where)
    check_tls_keys(settings, where, listen, connect)
    _check_rules(settings, where)
    is_safe = ENCRYPTED_PROTOCOLS if requires_client_certificates(settings) else ()
    exposed = [
        text
        for text, endpoint in zip(listen, map(parse_endpoint, listen), strict=True)
        if _is_network_endpoint(endpoint) and endpoint.protocol not in is_safe
    ]
    if not exposed:
        return ""
    open_to_all = f"anyone in the network may connect to {', '.join(exposed)}"
    return f"{where}: {open_to_all}; docs/guide/remote-access.md"


def _check_endpoint(text: str, where: str) -> None:
    if text.partition("/")[0] in _PATH_PROTOCOLS:
        return
    endpoint = parse_endpoint(text)
    if endpoint.protocol not in (*_UNENCRYPTED, *ENCRYPTED_PROTOCOLS) or int(endpoint.port) > 65535:
        raise InputError(
            f"{where}: {json.dumps(text)} is not an endpoint; write PROTOCOL/ADDRESS:PORT, such as "
            f"{DEFAULT_ENDPOINT} or tls/robot1.local:7451"
        )


def _is_network_endpoint(endpoint: Endpoint) -> bool:
    if not endpoint.host:
        return False  # a pipe, or a socket in the file system
    if endpoint.address is None:
        return endpoint.host != "localhost"
    return not endpoint.address.is_loopback


def _check_rules(settings: zenoh.Config, where: str) -> None:
    """Let Zenoh read its rules in a session that neither listens nor connects."""
    for key, value in (("mode", '"peer"'), ("listen/endpoints", "[]"), ("connect/endpoints", "[]")):
        settings.insert_json5(key, value)
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        settings.insert_json5(key, "false")
    try:
        zenoh.open(settings).close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        reason = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
        plain = " ".join(reason.split()).removeprefix("Access control not enabled due to: ")
        raise InputError(f"{where}: {plain}; correct it there") from error
