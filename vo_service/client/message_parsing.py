"""Reading the service's JSON: of a known version, and of the shape that it is to have."""

import json
from collections.abc import Mapping
from typing import Any

import zenoh

# The only version of the messages that this client can read.
SUPPORTED_SCHEMA = 1

JsonObject = Mapping[str, Any]


def parse_json(payload: zenoh.ZBytes) -> JsonObject:
    """One of the service's JSON messages. Raises ValueError."""
    try:
        content = json.loads(payload.to_bytes())
    except RecursionError as error:
        raise ValueError("a message is nested too deeply") from error
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SUPPORTED_SCHEMA:
        raise ValueError(
            f"a message of version {found}, only {SUPPORTED_SCHEMA} is known here; use the client "
            "that came with that service"
        )
    known: JsonObject = content
    return known


def parse_status(payload: zenoh.ZBytes) -> JsonObject:
    """A status. Raises ValueError."""
    status = parse_json(payload)
    check_fields("a status", status, {"state": str, "reason": str, "paused": bool})
    return status


def check_fields(what: str, message: JsonObject, kinds: Mapping[str, type]) -> None:
    """Raise ValueError unless the message has these fields, of just these types."""
    missing = kinds.keys() - message.keys()
    if missing:
        raise ValueError(f"{what} came without {', '.join(sorted(missing))}")
    for name, kind in kinds.items():
        if type(message[name]) is not kind:  # to isinstance, true is a whole number
            found = type(message[name]).__name__
            raise ValueError(f"{what} came with a {found} for {name}, not {kind.__name__}")
