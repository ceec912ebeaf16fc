"""Checks a value against a JSON Schema: the keywords that our schemas use, and no others."""

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
    """What is wrong with the value. Fails on a keyword that is not known here."""
    return [
        f"{where}: {complaint}"
        for keyword, wanted in schema.items()
        for complaint in _CHECKS[keyword](schema, wanted, value)
    ]


def _check_type(schema: Schema, wanted: str, value: Any) -> Iterator[str]:
    is_bool = isinstance(value, bool) and wanted != "boolean"
    if is_bool or not isinstance(value, _TYPES[wanted]):
        yield f"{value!r} is no {wanted}"


def _check_properties(schema: Schema, wanted: Mapping[str, Schema], value: Any) -> Iterator[str]:
    for name in wanted.keys() & _as_object(value).keys():
        yield from schema_errors(wanted[name], value[name], name)


def _check_additional_properties(
    schema: Schema, wanted: bool | Schema, value: Any
) -> Iterator[str]:
    for name in _as_object(value).keys() - schema.get("properties", {}).keys():
        if isinstance(wanted, bool):
            yield from [] if wanted else [f"{name} is not known"]
        else:
            yield from schema_errors(wanted, value[name], name)


def _check_dependent_required(
    schema: Schema, wanted: Mapping[str, list[str]], value: Any
) -> Iterator[str]:
    for name in wanted.keys() & _as_object(value).keys():
        yield from _check_required(wanted[name], value)


def _check_required(names: list[str], value: Any) -> Iterator[str]:
    return (f"{name} is missing" for name in names if name not in _as_object(value))


def _check_items(schema: Schema, wanted: Schema, value: Any) -> Iterator[str]:
    for index, item in enumerate(value if isinstance(value, list) else []):
        yield from schema_errors(wanted, item, f"[{index}]")


def _as_object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _make_check(holds: Callable[[Any, Any], bool], kinds: type | tuple[type, ...]) -> Any:
    def check(schema: Schema, wanted: Any, value: Any) -> Iterator[str]:
        if isinstance(value, kinds) and not holds(value, wanted):
            yield f"{value!r} does not agree with {wanted!r}"

    return check


def _accept_anything(schema: Schema, wanted: Any, value: Any) -> Iterator[str]:
    return iter(())


_CHECKS: Mapping[str, Callable[[Schema, Any, Any], Iterator[str]]] = {
    "$schema": _accept_anything,
    "title": _accept_anything,
    "description": _accept_anything,
    "type": _check_type,
    "properties": _check_properties,
    "required": lambda _, wanted, value: _check_required(wanted, value),
    "additionalProperties": _check_additional_properties,
    "dependentRequired": _check_dependent_required,
    "items": _check_items,
    "const": _make_check(lambda value, wanted: value == wanted, object),
    "enum": _make_check(lambda value, wanted: value in wanted, object),
    "minimum": _make_check(lambda value, wanted: value >= wanted, (int, float)),
    "maximum": _make_check(lambda value, wanted: value <= wanted, (int, float)),
    "minItems": _make_check(lambda value, wanted: len(value) >= wanted, list),
    "maxItems": _make_check(lambda value, wanted: len(value) <= wanted, list),
    "pattern": _make_check(lambda value, wanted: bool(re.search(wanted, value)), str),
}
