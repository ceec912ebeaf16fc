"""JSON Schemas (draft 2020-12) of all JSON over Zenoh, generated from the code.

Outgoing messages may get more keys without a new schema number. Incoming ones may have no others.
"""

import dataclasses
from collections.abc import Mapping
from enum import StrEnum
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from vo_service.command_parser import COMMAND_NAMES
from vo_service.outputs.zenoh.command_schemas import ARGUMENT_SCHEMAS, RESULT_SCHEMAS
from vo_service.outputs.zenoh.messages import MESSAGE_SCHEMA
from vo_service.types import (
    ErrorCode,
    MapReport,
    Status,
    TrackingState,
    field_description,
)

JSON_SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]

_PRIMITIVE_SCHEMAS: Mapping[Any, Schema] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    NoneType: {"type": "null"},
}
_SCHEMA_FIELD: Schema = {
    "const": MESSAGE_SCHEMA,
    "description": "version of the message; a reader must refuse an unknown version",
}
VERSIONS_DESCRIPTION = "versions of the program, of Python and of the libraries that affect poses"
_TEXT: Schema = {"type": "string"}


def all_schemas() -> dict[str, Schema]:
    """Return all schemas by name."""
    commands = {
        f"{name}-{part}": schema
        for name in COMMAND_NAMES
        for part, schema in (
            ("arguments", _arguments_schema(name)),
            ("answer", _result_schema(name)),
        )
    }
    return {
        "odom-attachment": _odom_attachment_schema(),
        "map-odom-attachment": _map_odom_attachment_schema(),
        "status": _status_schema(),
        "error": _error_schema(),
        **commands,
    }


def schema_of(annotation: Any) -> Schema:
    """Return the schema of a field's type. Raises TypeError for an unknown type."""
    if annotation in _PRIMITIVE_SCHEMAS:
        return _PRIMITIVE_SCHEMAS[annotation]
    if isinstance(annotation, type) and issubclass(annotation, StrEnum):
        return {"enum": [str(value) for value in annotation]}
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        properties = _field_schemas(annotation)
        return {"type": "object", "properties": properties, "required": list(properties)}
    match get_origin(annotation), get_args(annotation):
        case origin, (item, ellipsis) if origin is tuple and ellipsis is Ellipsis:
            return {"type": "array", "items": schema_of(item)}
        case origin, (key, value) if origin is Mapping and key is str:
            return {"type": "object", "additionalProperties": schema_of(value)}
    raise TypeError(f"no schema for a field of type {annotation}")


def _odom_attachment_schema() -> Schema:
    return _message_schema(
        "Attachment of a pose on PREFIX/odom and PREFIX/latest",
        {
            "seq": {
                "type": "integer",
                "minimum": 0,
                "description": "number of the pose, from 0 at each start of the service",
            },
            "state": {
                "enum": [state for state in TrackingState if state is not TrackingState.NO_CAMERA],
                "description": field_description(Status, "state"),
            },
            "epoch": {"type": "integer", "description": field_description(Status, "epoch")},
            "reason": {
                "type": "string",
                "description": 'reason of the state or of a new epoch; "" if there is none',
            },
        },
    )


def _map_odom_attachment_schema() -> Schema:
    return _message_schema(
        "Attachment of the map->odom transform, on PREFIX/map_odom",
        {
            "seq": {
                "type": "integer",
                "minimum": 0,
                "description": "number of the newest pose, which has the same stamp",
            },
            "epoch": {
                "type": "integer",
                "description": "epoch of that pose; the transform is invalid for other epochs",
            },
            "is_localized": {
                "type": "boolean",
                "description": field_description(MapReport, "is_localized"),
            },
            "map_keyframes": {
                "type": "integer",
                "description": field_description(MapReport, "keyframes"),
            },
            "loop_closures": {
                "type": "integer",
                "description": field_description(MapReport, "loop_closures"),
            },
        },
    )


def _status_schema() -> Schema:
    versions = schema_of(Mapping[str, str]) | {"description": VERSIONS_DESCRIPTION}
    return _message_schema(
        "Status of the service on PREFIX/status", _field_schemas(Status) | {"versions": versions}
    )


def _field_schemas(of: type) -> dict[str, Schema]:
    """Return the schemas of the fields of a dataclass of the status, with their descriptions."""
    types = get_type_hints(of)
    return {
        name: schema_of(annotation) | {"description": field_description(of, name)}
        for name, annotation in types.items()
    }


def _error_schema() -> Schema:
    fields = {
        "error": {"enum": list(ErrorCode), "description": "error code, for programs"},
        "message": _TEXT | {"description": "error message, for people"},
    }
    return _message_schema("Error reply to a query or a command", fields)


def _result_schema(name: str) -> Schema:
    return _message_schema(f"Reply of PREFIX/command/{name}", RESULT_SCHEMAS[name])


def _arguments_schema(name: str) -> Schema:
    return {
        "$schema": JSON_SCHEMA_DIALECT,
        "title": f"Arguments of PREFIX/command/{name}",
        "type": "object",
        **ARGUMENT_SCHEMAS[name],
        "additionalProperties": False,
    }


def _message_schema(title: str, fields: Mapping[str, Schema]) -> Schema:
    """Make the schema of an outgoing message: all fields are required, more are allowed."""
    return {
        "$schema": JSON_SCHEMA_DIALECT,
        "title": title,
        "type": "object",
        "properties": {"schema": _SCHEMA_FIELD, **fields},
        "required": ["schema", *fields],
    }
