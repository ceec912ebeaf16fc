"""Validates a value by a JSON Schema with the keywords that our schemas use."""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]

_TYPES: Mapping[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "null": (type(None),),
}


def schema_errors(schema: Schema, value: Any, where: str = "$") -> list[str]:
    """List the errors of a value. Raises KeyError for an unsupported keyword."""
    return [
        f"{where}: {error}"
        for keyword, argument in schema.items()
        for error in _CHECKS[keyword](schema, argument, value)
    ]


def _check_type(schema: Schema, argument: str, value: Any) -> Iterator[str]:
    is_bool = isinstance(value, bool) and argument != "boolean"
    if is_bool or not isinstance(value, _TYPES[argument]):
        yield f"{value!r} is not a {argument}"


def _check_properties(schema: Schema, argument: Mapping[str, Schema], value: Any) -> Iterator[str]:
    for name in argument.keys() & _as_object(value).keys():
        yield from schema_errors(argument[name], value[name], name)


def _check_additional_properties(
    schema: Schema, argument: bool | Schema, value: Any
) -> Iterator[str]:
    for name in _as_object(value).keys() - schema.get("properties", {}).keys():
        if isinstance(argument, bool):
            yield from [] if argument else [f"{name} is not known"]
        else:
            yield from schema_errors(argument, value[name], name)


def _check_dependent_required(
    schema: Schema, argument: Mapping[str, list[str]], value: Any
) -> Iterator[str]:
    for name in argument.keys() & _as_object(value).keys():
        yield from _check_required(argument[name], value)


def _check_required(names: list[str], value: Any) -> Iterator[str]:
    return (f"{name} is missing" for name in names if name not in _as_object(value))


def _check_items(schema: Schema, argument: Schema, value: Any) -> Iterator[str]:
    for index, item in enumerate(value if isinstance(value, list) else []):
        yield from schema_errors(argument, item, f"[{index}]")


def _as_object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _make_check(is_valid: Callable[[Any, Any], bool], kinds: type | tuple[type, ...]) -> Any:
    def check(schema: Schema, argument: Any, value: Any) -> Iterator[str]:
        if isinstance(value, kinds) and not is_valid(value, argument):
            yield f"{value!r} does not agree with {argument!r}"

    return check


def _accept_anything(schema: Schema, argument: Any, value: Any) -> Iterator[str]:
    return iter(())


_CHECKS: Mapping[str, Callable[[Schema, Any, Any], Iterator[str]]] = {
    "$schema": _accept_anything,
    "title": _accept_anything,
    "description": _accept_anything,
    "type": _check_type,
    "properties": _check_properties,
    "required": lambda _, argument, value: _check_required(argument, value),
    "additionalProperties": _check_additional_properties,
    "dependentRequired": _check_dependent_required,
    "items": _check_items,
    "const": _make_check(lambda value, argument: value == argument, object),
    "enum": _make_check(lambda value, argument: value in argument, object),
    "minimum": _make_check(lambda value, argument: value >= argument, (int, float)),
    "maximum": _make_check(lambda value, argument: value <= argument, (int, float)),
    "minItems": _make_check(lambda value, argument: len(value) >= argument, list),
    "maxItems": _make_check(lambda value, argument: len(value) <= argument, list),
    "pattern": _make_check(lambda value, argument: bool(re.search(argument, value)), str),
}
