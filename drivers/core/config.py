"""TOML files read into dataclasses, with errors that name file, line and key."""

import dataclasses
import difflib
import json
import math
import re
import tomllib
import types
from collections.abc import Iterable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from drivers.core.errors import InputError

KeyPath = tuple[str, ...]


def find_key_lines(text: str) -> dict[KeyPath, int]:
    """Find the first line (from 1) of every key and table of a valid TOML text.

    `tomllib` does not give line numbers. Dotted keys are tuples.
    """
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    for number, statement in _split_statements(text):
        parsed = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            table = _header_path(parsed)
            paths = [table[:depth] for depth in range(1, len(table) + 1)]
        else:
            paths = [table + path for path in _key_paths(parsed)]
        for path in paths:
            lines.setdefault(path, number)
    return lines


def find_syntax_error_line(error: Exception, text: str) -> int:
    """Find the line (from 1) in a message of `tomllib`; the last line if it names the end."""
    match = re.search(r"at line (\d+)", str(error))
    return int(match[1]) if match else max(1, len(text.splitlines()))


def _split_statements(text: str) -> Iterator[tuple[int, str]]:
    """Split into (line number, statement), a statement being the fewest lines that are valid TOML.

    So `tomllib` handles all of the grammar (quoted keys, multi-line strings and arrays).
    """
    pending, start = "", 1
    for number, line in enumerate(text.split("\n"), 1):
        pending += line + "\n"
        if _is_toml(pending):
            yield start, pending
            pending, start = "", number + 1


def _is_toml(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _header_path(header: Any) -> KeyPath:
    """Return a table's path from its parsed header, which nests exactly one key per level."""
    path: list[str] = []
    while header:
        key, header = next(iter(header.items()))
        path.append(key)
        header = header[0] if isinstance(header, list) else header
    return tuple(path)


def _key_paths(parsed: dict[str, Any]) -> Iterator[KeyPath]:
    for key, value in parsed.items():
        yield (key,)
        if isinstance(value, dict):
            yield from ((key, *rest) for rest in _key_paths(value))


SCHEMA_VERSION = 1
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class FieldSpec:
    """A key's description and the range of its value (or of each value of its list)."""

    description: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    exclusive_minimum: float = -math.inf

    @property
    def hint(self) -> str:
        """The description in parentheses, to append to a message; "" if there is none."""
        return f" ({self.description})" if self.description else ""

    @property
    def range_text(self) -> str:
        """The range in words; "" if it is unbounded."""
        bounds = []
        if self.minimum > -math.inf:
            bounds.append(f"at least {self.minimum:.15g}")
        if self.exclusive_minimum > -math.inf:
            bounds.append(f"more than {self.exclusive_minimum:.15g}")
        if self.maximum < math.inf:
            bounds.append(f"at most {self.maximum:.15g}")
        return " and ".join(bounds)


def config_field(
    default: T,
    description: str,
    *,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    exclusive_minimum: float = -math.inf,
) -> T:
    """Declare a dataclass field with a default.

    A value must fulfill minimum <= value <= maximum and value > exclusive_minimum.
    """
    metadata = {"description": FieldSpec(description, minimum, maximum, exclusive_minimum)}
    return dataclasses.field(default=default, metadata=metadata)


def required_field(
    description: str,
    *,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    exclusive_minimum: float = -math.inf,
) -> Any:
    """Declare a dataclass field that the file must set, with the range of `config_field`."""
    return dataclasses.field(
        metadata={"description": FieldSpec(description, minimum, maximum, exclusive_minimum)}
    )


def read_toml(path: Path, kind: type[T]) -> T:
    """Read a file into the dataclass `kind`. A Path is kept as it is written in the file.

    Raises:
        InputError: The file is invalid. The message is ``FILE:LINE: key `a.b`: reason; action``.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        cause = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"{path}: cannot be read: {cause}; name a TOML file") from error
    return parse_toml(text, str(path), kind)


def parse_toml(text: str, name: str, kind: type[T]) -> T:
    """Parse a TOML text as `read_toml` does; error messages start with `name`."""
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        line = find_syntax_error_line(error, text)
        raise InputError(
            f"{name}:{line}: not TOML: {error}; write `key = value`, text in double quotes"
        ) from error
    try:
        _check_schema_version(table)
        return _build_dataclass(kind, {k: v for k, v in table.items() if k != "schema"}, ())
    except _BadKeyError as bad:
        line = find_key_lines(text).get(bad.path, 0)
        raise InputError(f"{name}{f':{line}' if line else ''}: {bad}") from bad.__cause__


class _BadKeyError(Exception):
    def __init__(self, path: KeyPath, reason: str) -> None:
        super().__init__(f"key `{'.'.join(path)}`: {reason}" if path else reason)
        self.path = path


def _check_schema_version(table: dict[str, Any]) -> None:
    if "schema" not in table:
        raise _BadKeyError(
            ("schema",), f"is missing; put `schema = {SCHEMA_VERSION}` at the top of the file"
        )
    version = table["schema"]
    if type(version) is not int or version != SCHEMA_VERSION:
        raise _BadKeyError(
            ("schema",),
            f"version {_format_value(version)} cannot be read, only {SCHEMA_VERSION}; install the "
            "kinect-vo that the file was written for, or rewrite the file with "
            f"`schema = {SCHEMA_VERSION}`",
        )


def _build_dataclass(kind: type[T], table: dict[str, Any], path: KeyPath) -> T:
    fields = {f.name: f for f in dataclasses.fields(cast(Any, kind))}
    hints = get_type_hints(kind)
    for key in table:
        if key not in fields:
            raise _BadKeyError((*path, key), f"is unknown; {_suggest_name(key, fields)}")
    values = {}
    for name, field in fields.items():
        spec = field.metadata.get("description", FieldSpec())
        if name in table:
            values[name] = _convert_value(hints[name], table[name], spec, (*path, name))
        elif field.default is field.default_factory is dataclasses.MISSING:
            raise _BadKeyError((*path, name), f"is missing; add `{name} = ...`{spec.hint}")
    try:
        return kind(**values)
    except (ValueError, InputError) as error:
        raise _BadKeyError(path, str(error)) from error


def _convert_value(kind: Any, value: Any, spec: FieldSpec, path: KeyPath) -> Any:
    """Check a parsed TOML value and convert it to the type `kind`."""
    if get_origin(kind) in (types.UnionType, Union):
        kind = next(arm for arm in get_args(kind) if arm is not type(None))
    if dataclasses.is_dataclass(kind):
        _check_type(isinstance(value, dict), "a table", value, spec, path)
        return _build_dataclass(cast(type[Any], kind), value, path)
    if get_origin(kind) in (list, tuple):
        return _convert_sequence(kind, value, spec, path)
    if kind is float or kind is int:
        return _convert_number(kind, value, spec, path)
    if kind is bool:
        _check_type(isinstance(value, bool), "true or false", value, spec, path)
        return value
    if not issubclass(kind, (str, Path)):
        raise TypeError(f"settings of type {kind} cannot be read: {'.'.join(path)}")
    _check_type(isinstance(value, str), "text in double quotes", value, spec, path)
    if issubclass(kind, StrEnum) and value not in set(kind):
        raise _BadKeyError(
            path, f"{_format_value(value)} is not a choice; {_suggest_name(value, kind)}"
        )
    return kind(value)


def _convert_sequence(kind: Any, value: Any, spec: FieldSpec, path: KeyPath) -> Any:
    items = get_args(kind)
    length = None if get_origin(kind) is list or items[-1] is ... else len(items)
    expected = "a list" if length is None else f"a list of {length}"
    is_valid = isinstance(value, list) and length in (None, len(value))
    _check_type(is_valid, expected, value, spec, path)
    return get_origin(kind)(_convert_value(items[0], item, spec, path) for item in value)


def _convert_number(kind: type[Any], value: Any, spec: FieldSpec, path: KeyPath) -> Any:
    allowed = (int, float) if kind is float else (int,)
    is_number = isinstance(value, allowed) and not isinstance(value, bool)
    _check_type(is_number, "a number" if kind is float else "a whole number", value, spec, path)
    if isinstance(value, float) and not math.isfinite(value):
        raise _BadKeyError(path, f"{value} is not allowed; give a finite number{spec.hint}")
    if value < spec.minimum or value > spec.maximum or value <= spec.exclusive_minimum:
        raise _BadKeyError(path, f"{value} is out of range; give {spec.range_text}{spec.hint}")
    try:
        return kind(value)
    except OverflowError as error:
        raise _BadKeyError(path, "is too large for a number; shorten it") from error


def _check_type(is_valid: bool, expected: str, value: Any, spec: FieldSpec, path: KeyPath) -> None:
    if not is_valid:
        text = _format_value(value)
        raise _BadKeyError(path, f"{text} is the wrong type; give {expected}{spec.hint}")


def _format_value(value: Any) -> str:
    """Format a value briefly, about as the file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        text = json.dumps(value, ensure_ascii=False)
        return text if len(text) <= 60 else f'{text[:57]}..."'
    if isinstance(value, dict):
        return "a table"
    return f"a list of {len(value)}" if isinstance(value, list) else str(value)


def _suggest_name(name: str, known: Iterable[str]) -> str:
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f"did you mean `{close[0]}`?" if close else f"known here: {', '.join(names)}"
