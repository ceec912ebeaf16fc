"""JSON Schemas (draft 2020-12) of the messages over Zenoh."""

from vo_service.control.errors import ErrorCode

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def error_schema() -> dict[str, object]:
    """Of an error reply."""
    return {
        "$schema": DIALECT,
        "type": "object",
        "properties": {
            "schema": {"const": 1},
            "error": {"enum": list(ErrorCode)},
            "message": {"type": "string"},
        },
        "required": ["schema", "error", "message"],
        "additionalProperties": False,
    }


def all_schemas() -> dict[str, object]:
    """Every schema by the name of its message."""
    return {"error": error_schema()}
