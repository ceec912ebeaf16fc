"""JSON Schemas of the commands' arguments and replies, with the parser's limits."""

from collections.abc import Mapping
from typing import Any

from drivers.sensor_config import Led
from vo_service.command_parser import MAX_POSITION_M, MAX_TILT_DEG, QUATERNION_NORM_TOLERANCE
from vo_service.types import NAME_PATTERN

Schema = dict[str, Any]


def _number_array(count: int, limit: float, description: str) -> Schema:
    return {
        "type": "array",
        "items": {"type": "number", "minimum": -limit, "maximum": limit},
        "minItems": count,
        "maxItems": count,
        "description": description,
    }


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
