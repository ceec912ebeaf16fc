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


def complaints(schema: Schema, value: Any, where: str = "$") -> list[str]:
    """What is wrong with the value. Fails on a keyword that is not known here."""
    return [
        f"{where}: {complaint}"
        for keyword, wanted in schema.items()
        for complaint in _CHECKS[keyword](schema, wanted, value)
    ]


def _type(schema: Schema, wanted: str, value: Any) -> Iterator[str]:
    is_bool = isinstance(value, bool) and wanted != "boolean"
    if is_bool or not isinstance(value, _TYPES[wanted]):
        yield f"{value!r} is no {wanted}"


def _properties(schema: Schema, wanted: Mapping[str, Schema], value: Any) -> Iterator[str]:
    for name in wanted.keys() & _object(value).keys():
        yield from complaints(wanted[name], value[name], name)


def _others(schema: Schema, wanted: bool | Schema, value: Any) -> Iterator[str]:
    for name in _object(value).keys() - schema.get("properties", {}).keys():
        if isinstance(wanted, bool):
            yield from [] if wanted else [f"{name} is not known"]
        else:
            yield from complaints(wanted, value[name], name)


def _together(schema: Schema, wanted: Mapping[str, list[str]], value: Any) -> Iterator[str]:
    for name in wanted.keys() & _object(value).keys():
        yield from _missing(wanted[name], value)


def _missing(names: list[str], value: Any) -> Iterator[str]:
    return (f"{name} is missing" for name in names if name not in _object(value))


def _items(schema: Schema, wanted: Schema, value: Any) -> Iterator[str]:
    for index, item in enumerate(value if isinstance(value, list) else []):
        yield from complaints(wanted, item, f"[{index}]")


def _object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _unless(holds: Callable[[Any, Any], bool], kinds: type | tuple[type, ...]) -> Any:
    def check(schema: Schema, wanted: Any, value: Any) -> Iterator[str]:
        if isinstance(value, kinds) and not holds(value, wanted):
            yield f"{value!r} does not agree with {wanted!r}"

    return check


def _any(schema: Schema, wanted: Any, value: Any) -> Iterator[str]:
    return iter(())


_CHECKS: Mapping[str, Callable[[Schema, Any, Any], Iterator[str]]] = {
    "$schema": _any,
    "title": _any,
    "description": _any,
    "type": _type,
    "properties": _properties,
    "required": lambda _, wanted, value: _missing(wanted, value),
    "additionalProperties": _others,
    "dependentRequired": _together,
    "items": _items,
    "const": _unless(lambda value, wanted: value == wanted, object),
    "enum": _unless(lambda value, wanted: value in wanted, object),
    "minimum": _unless(lambda value, wanted: value >= wanted, (int, float)),
    "maximum": _unless(lambda value, wanted: value <= wanted, (int, float)),
    "minItems": _unless(lambda value, wanted: len(value) >= wanted, list),
    "maxItems": _unless(lambda value, wanted: len(value) <= wanted, list),
    "pattern": _unless(lambda value, wanted: bool(re.search(wanted, value)), str),
}
