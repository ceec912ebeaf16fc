"""All keys of the configuration as a page of Markdown, from the code that reads them."""

import dataclasses
import json
import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

from drivers.strict_toml import SCHEMA, Description
from vo_service.config import Config
from vo_service.reload import LIVE_KEYS

COMMAND = "kinect-vo config reference"
INTRODUCTION = f"""\
# Configuration

Every key of the file that `kinect-vo run --config FILE` reads, with its default;
[config/kinect.toml](../config/kinect.toml) is such a file. This page is written by `{COMMAND}`.

The file is TOML and begins with `schema = {SCHEMA}`. Every table and every key below may be left
out, unless it says *required*. A key that is not known, a value of a wrong type or out of range is
refused with its file, line and reason; `kinect-vo config check FILE` says so before anyone relies
on the file.

"Read again" says what a change does when a running service is told to read its file again
(`systemctl reload kinect-vo`, or SIGHUP): it counts at once, or from the next start on.
"""
SYNTHETIC = """\
For `camera.source = "synthetic"`. Without this table a light one is played: quickly rendered
(`duration_s = 10.0`, `texel_m = 0.004`, neither lens distortion nor motion blur), then
played round and round (`loop = true`). With it, what it leaves out has the default below."""
# Words for what a table's class does not say itself.
ABOUT = {"synthetic": SYNTHETIC, "synthetic.camera": "Intrinsics of both images, all of them."}
HEAD = "| key | type | default | range | meaning | read again |\n|---|---|---|---|---|---|\n"


@dataclass(frozen=True)
class _Key:
    """One key of a table; `kind` without ``| None``."""

    name: str
    kind: Any
    default: Any
    description: Description


def reference() -> str:
    """The whole page, in the order of the tables in `Config`."""
    return INTRODUCTION + "".join(_table(key.kind, key.name) for key in _keys(Config))


def _table(kind: Any, path: str, brackets: str = "[{}]") -> str:
    """A table's section, then those of the tables inside it."""
    heading = f"\n## `{brackets.format(path)}`\n\n{_about(kind, path)}\n\n"
    rows, inner = "", ""
    for key in _keys(kind):
        below = f"{path}.{key.name}"
        if dataclasses.is_dataclass(key.kind):
            inner += _table(key.kind, below)
        elif dataclasses.is_dataclass(_item(key.kind)):
            inner += _table(_item(key.kind), below, "[[{}]]")
        else:
            rows += _row(key, below)
    return heading + HEAD + rows + inner


def _keys(kind: Any) -> Iterator[_Key]:
    hints = get_type_hints(kind)
    for field in dataclasses.fields(kind):
        description = field.metadata.get("description", Description())
        yield _Key(field.name, _without_none(hints[field.name]), field.default, description)


def _about(kind: Any, path: str) -> str:
    """The first paragraph of the class's docstring, without the table's name before it."""
    if path in ABOUT:
        return ABOUT[path]
    paragraph = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
    text = paragraph.removeprefix(f"`[{path}]`: ").split(" Raises ")[0]
    return text[:1].upper() + text[1:]


def _row(key: _Key, path: str) -> str:
    again = "at once" if path in LIVE_KEYS else "next start"
    cells = (
        f"`{key.name}`",
        _type(key.kind),
        "*required*" if key.default is dataclasses.MISSING else _value(key.default),
        _range(key.description),
        key.description.about,
        again,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _type(kind: Any) -> str:
    """As a person would say it."""
    if get_origin(kind) in (list, tuple):
        items = get_args(kind)
        one = _type(items[0])
        return f"list of {one}" if items[-1] is ... else f"list of {len(items)} × {one}"
    if issubclass(kind, StrEnum):
        return ", ".join(f'`"{choice}"`' for choice in kind)
    names = {bool: "true or false", int: "whole number", float: "number", Path: "path", str: "text"}
    return names[kind]


def _range(description: Description) -> str:
    low, high = description.low, description.high
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.15g} to {high:.15g}"
    return description.range


def _value(value: Any) -> str:
    """As TOML has it."""
    if value is None:
        return "unset"
    listed = list(value) if isinstance(value, tuple) else value
    return f"`{json.dumps(listed, default=str)}`"


def _without_none(kind: Any) -> Any:
    if get_origin(kind) in (types.UnionType, Union):
        return next(arm for arm in get_args(kind) if arm is not type(None))
    return kind


def _item(kind: Any) -> Any:
    """What a list holds; None for what is no list."""
    return get_args(kind)[0] if get_origin(kind) in (list, tuple) else None
