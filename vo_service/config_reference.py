"""The configuration reference: a page of Markdown with all keys, made from the config classes."""

import dataclasses
import json
import math
from enum import StrEnum
from pathlib import Path
from typing import Any, get_args, get_origin

from drivers.core.config import SCHEMA_VERSION
from drivers.core.fields import Field, TypedField, typed_fields
from vo_service.config import Config

REFERENCE_COMMAND = "kinect-vo config reference"
INTRODUCTION = f"""\
# Configuration

Every key of the file that `kinect-vo run --config FILE` reads, with its default;
[config/kinect.toml](../../config/kinect.toml) is such a file. `{REFERENCE_COMMAND}` writes this
page.

The file is TOML and begins with `schema = {SCHEMA_VERSION}`. Every table and every key below is
optional, except those marked *required*. An unknown key, or a value of a wrong type or out of
range, is refused with its file, line and reason. `kinect-vo config check FILE` checks a file
without starting the service.

The column "after reload" shows when a change takes effect after a running service has read its
file again (`systemctl reload kinect-vo`, or SIGHUP): at once, or at the next start.
"""
SYNTHETIC_DESCRIPTION = """\
For `camera.source = "synthetic"`. Without this table, a short sequence is rendered quickly
(`duration_s = 10.0`, `texel_m = 0.004`, neither lens distortion nor motion blur) and repeated
(`loop = true`). With this table, missing keys have the defaults below."""
# Descriptions of tables that replace the docstring of the class.
TABLE_DESCRIPTIONS = {
    "synthetic": SYNTHETIC_DESCRIPTION,
    "synthetic.camera": "Intrinsics of both images, all of them.",
}
TABLE_HEADER = (
    "| key | type | default | range | meaning | after reload |\n|---|---|---|---|---|---|\n"
)


def render_reference() -> str:
    """Render the page, with the tables in the order of `Config`."""
    return INTRODUCTION + "".join(_render_table(key.kind, key.name) for key in typed_fields(Config))


def _render_table(kind: Any, path: str, brackets: str = "[{}]") -> str:
    """Render a table's section, then those of the tables inside it."""
    heading = f"\n## `{brackets.format(path)}`\n\n{_table_description(kind, path)}\n\n"
    rows, inner = "", ""
    for key in typed_fields(kind):
        below = f"{path}.{key.name}"
        if dataclasses.is_dataclass(key.kind):
            inner += _render_table(key.kind, below)
        elif dataclasses.is_dataclass(_item_type(key.kind)):
            inner += _render_table(_item_type(key.kind), below, "[[{}]]")
        else:
            rows += _render_row(key, below)
    return heading + TABLE_HEADER + rows + inner


def _table_description(kind: Any, path: str) -> str:
    """First paragraph of the class's docstring, without the table's name."""
    if path in TABLE_DESCRIPTIONS:
        return TABLE_DESCRIPTIONS[path]
    paragraph = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
    text = paragraph.removeprefix(f"`[{path}]`: ").split(" Raises ")[0]
    return text[:1].upper() + text[1:]


def _render_row(key: TypedField, path: str) -> str:
    effect = "at once" if key.spec.is_reloadable else "next start"
    cells = (
        f"`{key.name}`",
        format_type(key.kind),
        "*required*" if key.is_required else _format_value(key.default),
        _format_range(key.spec),
        key.spec.description,
        effect,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def format_type(kind: Any) -> str:
    """Name a type in plain English."""
    if get_origin(kind) in (list, tuple):
        items = get_args(kind)
        one = format_type(items[0])
        return f"list of {one}" if items[-1] is ... else f"list of {len(items)} × {one}"
    if issubclass(kind, StrEnum):
        return ", ".join(f'`"{choice}"`' for choice in kind)
    names = {bool: "true or false", int: "whole number", float: "number", Path: "path", str: "text"}
    return names[kind]


def _format_range(spec: Field) -> str:
    low, high = spec.minimum, spec.maximum
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.15g} to {high:.15g}"
    return spec.range_text


def _format_value(value: Any) -> str:
    """Format a value as in TOML."""
    if value is None:
        return "unset"
    listed = list(value) if isinstance(value, tuple) else value
    return f"`{json.dumps(listed, default=str)}`"


def _item_type(kind: Any) -> Any:
    """Type of a list's items; None if `kind` is not a list."""
    return get_args(kind)[0] if get_origin(kind) in (list, tuple) else None
