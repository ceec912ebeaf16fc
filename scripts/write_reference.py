"""Write what the definitions of messages, commands, configuration keys and parameters determine.

These are the JSON Schemas in ``schemas/``, the man page and completions in ``share/``, the commands
and the configuration in ``docs/reference/``, and the tables in ``docs/reference/messages.md`` and
``docs/design/direct.md`` between ``<!-- NAME: ... -->`` and ``<!-- end -->``.

Usage: .venv/bin/python -m scripts.write_reference
"""

import ast
import dataclasses
import inspect
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_origin

from drivers.core.config import TypedField, typed_fields
from scripts.command_reference import render_commands, render_completion, render_man_page
from vo_service.cli.config import format_type, render_reference
from vo_service.outputs.zenoh.json_schemas import VERSIONS_DESCRIPTION, all_schemas
from vo_service.types.commands import COMMANDS, Command
from vo_service.types.messages import MESSAGE_SCHEMA, MapOdomAttachment, OdomAttachment, Status

ROOT = Path(__file__).parents[1]
SCHEMA_FOLDER = ROOT / "schemas"
CONFIGURATION = ROOT / "docs" / "reference" / "configuration.md"
MESSAGES = ROOT / "docs" / "reference" / "messages.md"
DIRECT = ROOT / "docs" / "design" / "direct.md"
PARAMETERS = ROOT / "vo_service" / "odometry" / "direct" / "parameters.py"
COMMAND_PAGE = ROOT / "docs" / "reference" / "cli.md"
MAN_PAGE = ROOT / "share" / "man" / "man1" / "kinect-vo.1"
BASH_COMPLETION = ROOT / "share" / "bash-completion" / "completions" / "kinect-vo"
ZSH_COMPLETION = ROOT / "share" / "zsh" / "site-functions" / "_kinect-vo"


def make_files() -> dict[Path, str]:
    """Return the text of each file."""
    schemas = {
        SCHEMA_FOLDER / f"{name}.json": json.dumps(schema, indent=2) + "\n"
        for name, schema in all_schemas().items()
    }
    return schemas | {
        CONFIGURATION: render_reference(),
        MESSAGES: replace_tables(MESSAGES, message_tables()),
        DIRECT: replace_tables(DIRECT, {"parameters": parameter_table(PARAMETERS.read_text())}),
        COMMAND_PAGE: render_commands(),
        MAN_PAGE: render_man_page(),
        BASH_COMPLETION: render_completion("bash"),
        ZSH_COMPLETION: render_completion("zsh"),
    }


def replace_tables(file: Path, tables: Mapping[str, str]) -> str:
    """Return the text of a page with other tables, by their names."""
    page = file.read_text()
    for name, table in tables.items():
        begin = f"<!-- {name}: written by scripts/write_reference.py -->\n"
        pattern = re.compile(f"{re.escape(begin)}.*?<!-- end -->\n", re.DOTALL)
        page, count = pattern.subn(lambda _: f"{begin}{table}<!-- end -->\n", page)  # noqa: B023
        if count != 1:
            raise ValueError(f"{file}: there must be one table {name}")
    return page


def parameter_table(source: str) -> str:
    """Return the table of the parameters in a module: name, value, and the comment above.

    A comment in capitals is the heading of a section. A parameter without a comment belongs to the
    one above.
    """
    lines, rows = source.splitlines(), list[tuple[str, ...]]()
    for statement in ast.parse(source).body:
        if not isinstance(statement, ast.Assign):
            continue
        first = statement.lineno - 1
        while lines[first - 1].startswith("# "):
            first -= 1
        comment = [line.removeprefix("# ") for line in lines[first : statement.lineno - 1]]
        if comment and comment[0].isupper():
            rows.append((f"**{comment.pop(0).capitalize()}**", "", ""))
        meaning = " ".join(comment) or "see above"
        for name, value in _assigned(statement):
            text = ast.get_source_segment(source, value)
            rows.append((f"`{name}`", f"`{text}`", meaning.replace("|", "\\|")))
            meaning = "see above"
    return _table(("parameter", "value", "meaning"), rows)


def _assigned(statement: ast.Assign) -> Iterator[tuple[str, ast.expr]]:
    """The names that a statement assigns, each with its value."""
    target, value = statement.targets[0], statement.value
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        yield from zip(map(ast.unparse, target.elts), value.elts, strict=True)
    else:
        yield ast.unparse(target), value


def message_tables() -> dict[str, str]:
    """Return the tables of docs/reference/messages.md by name."""
    versions = ("versions", "object", VERSIONS_DESCRIPTION)
    return {
        "odom attachment": _message_table(OdomAttachment),
        "map_odom attachment": _message_table(MapOdomAttachment),
        "status": _message_table(Status, versions),
        "commands": _table(
            ("command", "arguments", "reply", "what it does"), map(_command_row, COMMANDS.values())
        ),
    }


def _message_table(of: type, *more_rows: tuple[str, ...]) -> str:
    schema = ("schema", "whole number", f"version of the message: {MESSAGE_SCHEMA}")
    rows = (schema, *_field_rows(of), *more_rows)
    return _table(("key", "type", "meaning"), ((f"`{key}`", *others) for key, *others in rows))


def _field_rows(of: type, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    for field in typed_fields(of):
        key = f"{prefix}{field.name}"
        yield key, _type_name(field), field.spec.description
        if dataclasses.is_dataclass(field.kind) and isinstance(field.kind, type):
            yield from _field_rows(field.kind, f"{key}.")


def _type_name(field: TypedField) -> str:
    if field.spec.choices:
        return ", ".join(f'`"{choice}"`' for choice in field.spec.choices)
    is_object = dataclasses.is_dataclass(field.kind) or get_origin(field.kind) is Mapping
    return "object" if is_object else format_type(field.kind)


def _command_row(command: type[Command]) -> tuple[str, ...]:
    arguments = [_describe_argument(field) for field in typed_fields(command)]
    reply = [f"`{field.name}`" for field in typed_fields(command.reply_type())]
    description = (inspect.getdoc(command) or "").partition("\n")[0].removesuffix(".")
    joint = "; both or none" if command.required_together else ""
    return (
        f"`{command.command_name}`",
        "; ".join(arguments) + joint,
        ", ".join(reply),
        description,
    )


def _describe_argument(field: TypedField) -> str:
    spec = field.spec
    form = spec.pattern_name or ", ".join(filter(None, (_type_name(field), spec.range_text)))
    return f"`{field.name}`: {spec.description}; {form}"


def _table(header: tuple[str, ...], rows: Any) -> str:
    lines = (header, tuple("---" for _ in header), *rows)
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def main() -> None:
    """Write all files and delete schemas that are no longer defined."""
    SCHEMA_FOLDER.mkdir(exist_ok=True)
    files = make_files()
    for file in set(SCHEMA_FOLDER.glob("*.json")) - files.keys():
        file.unlink()
    for file, text in files.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


if __name__ == "__main__":
    main()
