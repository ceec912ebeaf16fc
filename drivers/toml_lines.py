"""Where the keys of a TOML text stand: `tomllib` says what they hold, not on which line."""

import re
import tomllib
from collections.abc import Iterator
from typing import Any

KeyPath = tuple[str, ...]


def find_key_lines(text: str) -> dict[KeyPath, int]:
    """First line (from 1) of every key and table of a valid TOML text, dotted keys as tuples."""
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
    """Line (from 1) that a message of `tomllib` names; the last one where it names the end."""
    found = re.search(r"at line (\d+)", str(error))
    return int(found[1]) if found else max(1, len(text.splitlines()))


def _split_statements(text: str) -> Iterator[tuple[int, str]]:
    """Split into (line number, statement): the fewest whole lines that are valid TOML alone.

    So the grammar (quoted keys, strings and arrays over many lines) stays with `tomllib`.
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
    """Path of a table from its parsed header, which nests exactly one key in each level."""
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
