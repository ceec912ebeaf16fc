"""Check that the TLS keys of a Zenoh configuration exist, are readable and match."""

import json
import ssl
from collections.abc import Callable, Sequence

import zenoh

from drivers.core.errors import InputError

ENCRYPTED_PROTOCOLS = ("tls", "quic")


def check_tls_keys(
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
        if (
            side == "listen"
            and _has_encrypted_endpoint(endpoints)
            and not (certificate and key and root)
        ):
            raise InputError(
                f"{where}: to listen with TLS, transport.link.tls needs root_ca_certificate, "
                "listen_certificate and listen_private_key; see config/zenoh/robot-tls.json5"
            )


def requires_client_certificates(settings: zenoh.Config) -> bool:
    """Return whether TLS clients need a certificate."""
    return json.loads(settings.get_json("transport/link/tls/enable_mtls")) is True


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


def _has_encrypted_endpoint(endpoints: Sequence[str]) -> bool:
    return any(endpoint.partition("/")[0] in ENCRYPTED_PROTOCOLS for endpoint in endpoints)
