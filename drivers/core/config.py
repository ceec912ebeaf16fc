"""TOML files read into dataclasses, with errors that name file, line and key."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from drivers.core.errors import InputError
from drivers.core.fields import FieldError, KeyPath, build_dataclass, format_value


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
    """Parse a TOML text as `read_toml` does; error messages start with `name`.

    Args:
        text: The file's content.
        name: Name of the file, for errors.
        kind: The dataclass.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        line = find_syntax_error_line(error, text)
        raise InputError(
            f"{name}:{line}: not TOML: {error}; write `key = value`, text in double quotes"
        ) from error
    try:
        _check_schema_version(table)
        return build_dataclass(kind, {k: v for k, v in table.items() if k != "schema"})
    except FieldError as error:
        line = find_key_lines(text).get(error.path, 0)
        key = f"key `{'.'.join(error.path)}`: " if error.path else ""
        raise InputError(f"{name}{f':{line}' if line else ''}: {key}{error}") from error.__cause__


def _check_schema_version(table: dict[str, Any]) -> None:
    if "schema" not in table:
        raise FieldError(
            ("schema",), f"is missing; put `schema = {SCHEMA_VERSION}` at the top of the file"
        )
    version = table["schema"]
    if type(version) is not int or version != SCHEMA_VERSION:
        raise FieldError(
            ("schema",),
            f"version {format_value(version)} cannot be read, only {SCHEMA_VERSION}; install the "
            "kinect-vo that the file was written for, or rewrite the file with "
            f"`schema = {SCHEMA_VERSION}`",
        )
