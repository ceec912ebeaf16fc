"""Check of a Zenoh configuration without the network: endpoints, TLS keys, access rules."""

import json
import ssl
from collections.abc import Callable, Sequence

import zenoh

from drivers.core import InputError
from drivers.core.config import FieldError
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig
from vo_service.outputs.zenoh.addresses import (
    ENCRYPTED_PROTOCOLS,
    configured_endpoints,
    exposed_endpoints,
    is_endpoint,
    requires_client_certificates,
)
from vo_service.outputs.zenoh.session import open_with_shared_memory, without_source_locations
from vo_service.outputs.zenoh.zenoh_config import build_zenoh_config


def check_session_config(config: ZenohConfig) -> str:
    """Check the file, its keys, its rules and the endpoints, without listening or connecting.

    Returns:
        A warning about allowed but dangerous settings, one clause; "" if there are none.

    Raises:
        FieldError: An endpoint of the configuration is invalid.
        InputError: A setting is invalid.
    """
    settings = build_zenoh_config(config)
    where = str(config.config_file or "zenoh")
    listen, connect = (configured_endpoints(settings, key) for key in ("listen", "connect"))
    for key, own, endpoints in (
        ("listen", config.listen, listen),
        ("connect", config.connect, connect),
    ):
        for endpoint in endpoints:
            fault = _find_endpoint_fault(endpoint)
            if fault and endpoint in own:
                raise FieldError(("zenoh", key), fault)
            if fault:
                raise InputError(f"{where}: {fault}")
    _check_tls_keys(settings, where, listen, connect)
    _check_rules(settings, where)
    exposed = exposed_endpoints(listen, requires_client_certificates(settings))
    if not exposed:
        return ""
    open_to_all = f"anyone in the network may connect to {', '.join(exposed)}"
    return f"{where}: {open_to_all}; docs/guide/remote-access.md"


def _find_endpoint_fault(text: str) -> str:
    """Return why a text is not an endpoint; "" if it is one."""
    if is_endpoint(text):
        return ""
    return (
        f"{json.dumps(text)} is not an endpoint; write PROTOCOL/ADDRESS:PORT, such as "
        f"{DEFAULT_ENDPOINT} or tls/robot1.local:7451"
    )


def _check_rules(settings: zenoh.Config, where: str) -> None:
    """Let Zenoh read its rules in a session that neither listens nor connects."""
    for key, value in (("mode", '"peer"'), ("listen/endpoints", "[]"), ("connect/endpoints", "[]")):
        settings.insert_json5(key, value)
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        settings.insert_json5(key, "false")
    try:
        open_with_shared_memory(settings).close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        plain = without_source_locations(error).removeprefix("Access control not enabled due to: ")
        raise InputError(f"{where}: {plain}; correct it there") from error


def _check_tls_keys(
    settings: zenoh.Config, where: str, listen: Sequence[str], connect: Sequence[str]
) -> None:
    """Check the TLS keys of a configuration.

    Args:
        settings: The configuration.
        where: Its name, for the message.
        listen: Endpoints to listen on.
        connect: Endpoints to connect to.

    Raises:
        InputError: A key is missing, not readable or does not match; it names the file.
    """
    root = _tls_file(settings, "root_ca_certificate")
    if root:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        _run_ssl_load(lambda: context.load_verify_locations(root), where, root)
    for side, endpoints in (("listen", listen), ("connect", connect)):
        certificate = _tls_file(settings, f"{side}_certificate")
        key = _tls_file(settings, f"{side}_private_key")
        if certificate and key:
            _check_pair(certificate, key, where)
        is_encrypted = any(each.partition("/")[0] in ENCRYPTED_PROTOCOLS for each in endpoints)
        if side == "listen" and is_encrypted and not (certificate and key and root):
            raise InputError(
                f"{where}: to listen with TLS, transport.link.tls needs root_ca_certificate, "
                "listen_certificate and listen_private_key; see config/zenoh/robot-tls.json5"
            )


def _check_pair(certificate: str, key: str, where: str) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # An empty password: a prompt on the terminal would block forever.
    _run_ssl_load(
        lambda: context.load_cert_chain(certificate, key, password=lambda: ""),
        where,
        f"{certificate} with {key}",
    )


def _run_ssl_load(load: Callable[[], None], where: str, what: str) -> None:
    try:
        load()
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
        plain = str(reason).replace("_", " ").lower()
        raise InputError(
            f"{where}: {what}: {plain}; give matching PEM files without a password"
        ) from error


def _tls_file(settings: zenoh.Config, name: str) -> str:
    return json.loads(settings.get_json(f"transport/link/tls/{name}")) or ""
