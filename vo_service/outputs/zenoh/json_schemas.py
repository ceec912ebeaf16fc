"""JSON Schemas (draft 2020-12) of all JSON over Zenoh, generated from the dataclasses.

Outgoing messages may get more keys without a new schema number. Incoming ones may have no others.
"""

import dataclasses
import inspect
import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, get_args, get_origin

from drivers.core.config import Field, typed_fields
from vo_service.types.commands import COMMANDS, Command
from vo_service.types.messages import (
    MESSAGE_SCHEMA,
    ErrorReply,
    FrameAttachment,
    MapOdomAttachment,
    OdomAttachment,
    Status,
    TimingMessage,
)

Schema = dict[str, Any]
JSON_SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_PRIMITIVE_TYPES: Mapping[Any, str] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
}
_SCHEMA_FIELD: Schema = {
    "const": MESSAGE_SCHEMA,
    "description": "version of the message; a reader must refuse an unknown version",
}
VERSIONS_DESCRIPTION = "versions of the program, of Python and of the libraries that affect poses"


def all_schemas() -> dict[str, Schema]:
    """Return all schemas by name."""
    versions = schema_of(Mapping[str, str]) | {"description": VERSIONS_DESCRIPTION}
    schemas = {
        "odom-attachment": _message_schema(OdomAttachment),
        "map-odom-attachment": _message_schema(MapOdomAttachment),
        "frame-attachment": _message_schema(FrameAttachment),
        "timing": _message_schema(TimingMessage),
        "status": _message_schema(
            Status, "Status of the service on PREFIX/status", {"versions": versions}
        ),
        "error": _message_schema(ErrorReply),
    }
    for name, command in COMMANDS.items():
        reply_title = f"Reply of PREFIX/command/{name}"
        schemas[f"{name}-arguments"] = _arguments_schema(command)
        schemas[f"{name}-answer"] = _message_schema(command.reply_type(), reply_title)
    return schemas


def schema_of(kind: Any, spec: Field = Field()) -> Schema:  # noqa: B008 (frozen)
    """Return the schema of a field's value.

    Args:
        spec: Limits of the value, or of each number in it.

    Raises:
        TypeError: For an unknown type.
    """
    if spec.choices:
        return {"enum": [str(choice) for choice in spec.choices]}
    if kind in _PRIMITIVE_TYPES:
        return {"type": _PRIMITIVE_TYPES[kind], **_limits(spec)}
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return {"enum": [str(value) for value in kind]}
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        properties = _field_schemas(kind)
        return {"type": "object", "properties": properties, "required": list(properties)}
    match get_origin(kind), get_args(kind):
        case origin, (item, *others) if origin is tuple:
            count = 1 + len(others)
            length = {} if others == [...] else {"minItems": count, "maxItems": count}
            return {"type": "array", "items": schema_of(item, spec), **length}
        case origin, (key, value) if origin is Mapping and key is str:
            return {"type": "object", "additionalProperties": schema_of(value)}
    raise TypeError(f"no schema for a field of type {kind}")


def _limits(spec: Field) -> Schema:
    limits: Schema = {}
    if spec.pattern:
        limits["pattern"] = f"^(?:{spec.pattern})$"
    if spec.minimum > -math.inf:
        limits["minimum"] = spec.minimum
    if spec.maximum < math.inf:
        limits["maximum"] = spec.maximum
    return limits


def _field_schemas(of: type) -> dict[str, Schema]:
    return {
        field.name: schema_of(field.kind, field.spec) | {"description": field.spec.description}
        for field in typed_fields(of)
    }


def _message_schema(
    of: type, title: str = "", more_fields: Mapping[str, Schema] | None = None
) -> Schema:
    """Make the schema of an outgoing message: all fields are required, more are allowed."""
    fields = _field_schemas(of) | dict(more_fields or {})
    return {
        "$schema": JSON_SCHEMA_DIALECT,
        "title": title or (inspect.getdoc(of) or "").removesuffix("."),
        "type": "object",
        "properties": {"schema": _SCHEMA_FIELD, **fields},
        "required": ["schema", *fields],
    }


def _arguments_schema(command: type[Command]) -> Schema:
    required = [field.name for field in typed_fields(command) if field.is_required]
    together = command.required_together
    dependent = {name: [other for other in together if other != name] for name in together}
    return {
        "$schema": JSON_SCHEMA_DIALECT,
        "title": f"Arguments of PREFIX/command/{command.command_name}",
        "type": "object",
        "properties": _field_schemas(command),
        **({"required": required} if required else {}),
        **({"dependentRequired": dependent} if dependent else {}),
        "additionalProperties": False,
    }
