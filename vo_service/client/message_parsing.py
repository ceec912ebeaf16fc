"""Parsing and validation of the service's JSON."""

import json
from collections.abc import Mapping
from typing import Any

import zenoh

# The only message version that this client reads.
SUPPORTED_SCHEMA = 1

JsonObject = Mapping[str, Any]


def parse_json(payload: zenoh.ZBytes) -> JsonObject:
    """Parse one of the service's JSON messages.

    Raises:
        ValueError: If the message is not valid.
    """
    try:
        content = json.loads(payload.to_bytes())
    except RecursionError as error:
        raise ValueError("a message is nested too deeply") from error
    version = content.get("schema") if isinstance(content, dict) else None
    if version != SUPPORTED_SCHEMA:
        raise ValueError(
            f"a message has version {version}, but this client reads only {SUPPORTED_SCHEMA}; use "
            "the client of the service's version"
        )
    message: JsonObject = content
    return message


def parse_status(payload: zenoh.ZBytes) -> JsonObject:
    """Parse a status.

    Raises:
        ValueError: If it is not valid.
    """
    status = parse_json(payload)
    check_fields("a status", status, {"state": str, "reason": str, "paused": bool})
    return status


def check_fields(what: str, message: JsonObject, kinds: Mapping[str, type]) -> None:
    """Raise ValueError unless the message has these fields with exactly these types."""
    missing = kinds.keys() - message.keys()
    if missing:
        raise ValueError(f"{what} came without {', '.join(sorted(missing))}")
    for name, kind in kinds.items():
        if type(message[name]) is not kind:  # isinstance(True, int) holds
            actual = type(message[name]).__name__
            raise ValueError(f"{what} came with a {actual} for {name}, not {kind.__name__}")
