"""JSON Schemas (draft 2020-12) of all JSON over Zenoh, generated from the code.

Outgoing messages may get more keys without a new schema number. Incoming ones may have no others.
"""

import dataclasses
from collections.abc import Mapping
from enum import StrEnum
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from drivers.camera import Led
from vo_service.command_parser import (
    COMMAND_NAMES,
    MAX_POSITION_M,
    MAX_TILT_DEG,
    QUATERNION_NORM_TOLERANCE,
)
from vo_service.outputs.zenoh.messages import MESSAGE_SCHEMA
from vo_service.types import (
    NAME_PATTERN,
    ErrorCode,
    MapReport,
    Status,
    TrackingState,
    field_description,
)

Schema = dict[str, Any]
_LED: Schema = {"enum": [str(led) for led in Led], "description": "the sensor's LED"}
_TILT: Schema = {
    "type": "number",
    "minimum": -MAX_TILT_DEG,
    "maximum": MAX_TILT_DEG,
    "description": "degrees above the horizon",
}
_NAME: Schema = {
    "type": "string",
    "pattern": f"^(?:{NAME_PATTERN})$",
    "description": "name of the folder or of the map",
}
_NO_ARGUMENTS: Schema = {"properties": {}}
_EPOCH: Schema = {"type": "integer", "description": "number of the new epoch"}
_PAUSED: Schema = {"type": "boolean", "description": "whether publishing is paused"}
_FOLDER: Schema = {"type": "string", "description": "path on the service's computer"}
_FILE: Schema = {
    "type": "string",
    "description": "path on the service's computer; complete once `map.saved` in the status names "
    "it",
}
_LOADED: Schema = {
    "type": "string",
    "description": "path on the service's computer; loaded once `map.loaded` in the status names "
    "it",
}
_KEYFRAMES: Schema = {"type": "integer", "description": "number of keyframes in the map"}
RESULT_SCHEMAS: Mapping[str, Mapping[str, Schema]] = {
    "reset": {"epoch": _EPOCH},
    "pause": {"paused": _PAUSED},
    "resume": {"paused": _PAUSED},
    "tilt": {"tilt_deg": _TILT},
    "led": {"led": _LED},
    "start-recording": {"folder": _FOLDER},
    "stop-recording": {"folder": _FOLDER},
    "save-incident": {"folder": _FOLDER},
    "save-map": {"file": _FILE, "keyframes": _KEYFRAMES},
    "load-map": {"file": _LOADED},
}
JSON_SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
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


def _number_array(count: int, limit: float, description: str) -> Schema:
    return {
        "type": "array",
        "items": {"type": "number", "minimum": -limit, "maximum": limit},
        "minItems": count,
        "maxItems": count,
        "description": description,
    }


ARGUMENT_SCHEMAS: Mapping[str, Schema] = {
    "reset": {
        "properties": {
            "position_m": _number_array(
                3, MAX_POSITION_M, "new position of the base in odom, x y z, meters"
            ),
            "quaternion_xyzw": _number_array(
                4, 1.0 + QUATERNION_NORM_TOLERANCE, "new orientation of the base, unit length"
            ),
        },
        "dependentRequired": {
            "position_m": ["quaternion_xyzw"],
            "quaternion_xyzw": ["position_m"],
        },
    },
    "pause": _NO_ARGUMENTS,
    "resume": _NO_ARGUMENTS,
    "tilt": {"properties": {"tilt_deg": _TILT}, "required": ["tilt_deg"]},
    "led": {"properties": {"led": _LED}, "required": ["led"]},
    "start-recording": {"properties": {"name": _NAME}, "required": ["name"]},
    "stop-recording": _NO_ARGUMENTS,
    "save-incident": _NO_ARGUMENTS,
    "save-map": {"properties": {"name": _NAME}, "required": ["name"]},
    "load-map": {"properties": {"name": _NAME}, "required": ["name"]},
}


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
    """Return the schema of a field's type.

    Raises:
        TypeError: For an unknown type.
    """
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
