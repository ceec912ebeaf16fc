"""Parsing of a status."""

from dataclasses import dataclass

import zenoh

from vo_service.types import JsonObject, decode_message, parse_json_message


@dataclass(frozen=True)
class _RequiredStatusFields:
    state: str
    reason: str
    paused: bool


def parse_status(payload: zenoh.ZBytes) -> JsonObject:
    """Parse a status, and check the fields that the client reads.

    Raises:
        ValueError: If it is not valid.
    """
    status = parse_json_message(payload.to_bytes())
    decode_message(_RequiredStatusFields, status, "a status")
    return status
