"""TOML and JSON read into dataclasses, with errors that name file, line and key.

A field is declared once, ``rate_hz: Annotated[float, Field("frames a second", minimum=1)] = 30.0``
or, without limits, ``rate_hz: Annotated[float, "frames a second"] = 30.0``. The reader of TOML and
JSON, the error messages, the JSON Schemas and the reference pages use this declaration.
"""

import dataclasses
import difflib
import json
import math
import re
import tomllib
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from drivers.core import InputError
from drivers.core.input_files import read_input_text

KeyPath = tuple[str, ...]
T = TypeVar("T")

# For `Field.pattern`: names of recordings and maps, which become file names.
FILE_NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"
FILE_NAME_IN_WORDS = (
    "a plain name: up to 64 letters, digits, '_', '-' or '.', a letter or digit first"
)


@dataclasses.dataclass(frozen=True)
class Field:
    """Description and limits of a field: minimum <= value <= maximum, value > exclusive_minimum.

    Attributes:
        description: One phrase, with the unit.
        minimum: Least number, or least number in the field's list.
        maximum: Greatest number.
        exclusive_minimum: Number that every value exceeds.
        pattern: Regular expression that a text matches completely; "" = any text.
        pattern_name: The pattern in words.
        choices: The only allowed values of a text; () = any that the type has.
        is_reloadable: Whether a change takes effect while the service runs.
    """

    description: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    exclusive_minimum: float = -math.inf
    pattern: str = ""
    pattern_name: str = ""
    choices: tuple[str, ...] = ()
    is_reloadable: bool = False

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


@dataclasses.dataclass(frozen=True)
class TypedField:
    """A field of a dataclass as its declaration describes it.

    Attributes:
        kind: Type of the value, without ``| None``.
        default: Default value; `dataclasses.MISSING` without one.
        is_required: Whether there is neither a default nor a default factory.
    """

    name: str
    kind: Any
    spec: Field
    default: Any
    is_required: bool


def typed_fields(kind: type[Any]) -> list[TypedField]:
    """Return the fields of a dataclass, in order."""
    hints = get_type_hints(kind, include_extras=True)
    return [
        TypedField(
            field.name,
            *_split_annotation(hints[field.name]),
            field.default,
            field.default is field.default_factory is dataclasses.MISSING,
        )
        for field in dataclasses.fields(kind)
    ]


def _split_annotation(annotation: Any) -> tuple[Any, Field]:
    """Split ``Annotated[T | None, spec]`` into T and the spec; a text is a description."""
    spec: Any = ""
    if get_origin(annotation) is Annotated:
        annotation, spec = get_args(annotation)
    if get_origin(annotation) in (types.UnionType, Union):
        annotation = next(arm for arm in get_args(annotation) if arm is not types.NoneType)
    return annotation, spec if isinstance(spec, Field) else Field(spec)


class FieldError(InputError):
    """A value that does not fit the field's declaration; the text has the reason and what to do.

    Attributes:
        path: Names of the tables around the field and of the field; () = the whole object. "[1]" is
            the second table of a list.
    """

    def __init__(self, path: KeyPath, reason: str) -> None:
        super().__init__(reason)
        self.path = path


def build_dataclass(kind: type[T], values: Mapping[str, Any], path: KeyPath = ()) -> T:
    """Check parsed values of TOML or JSON and build the dataclass.

    Args:
        kind: The dataclass. Its `__post_init__` may raise a FieldError with the name of a field, or
            a ValueError or InputError if several fields do not fit together.
        values: By name of the field: the parsed value.
        path: Names of the tables around it, for errors.

    Raises:
        FieldError: For the first unknown, missing or wrong value.
    """
    fields = {field.name: field for field in typed_fields(kind)}
    for key in values:
        if key not in fields:
            raise FieldError((*path, key), f"is unknown; {suggest_name(key, fields)}")
    converted = {}
    for name, field in fields.items():
        if name in values:
            converted[name] = _convert(field.kind, values[name], field.spec, (*path, name))
        elif field.is_required:
            raise FieldError((*path, name), f"is missing; add `{name} = ...`{field.spec.hint}")
    try:
        return kind(**converted)
    except FieldError as error:
        raise FieldError((*path, *error.path), str(error)) from error
    except (ValueError, InputError) as error:
        raise FieldError(path, str(error)) from error


def _convert(kind: Any, value: Any, spec: Field, path: KeyPath) -> Any:
    """Check a parsed value and convert it to the type `kind`."""
    if dataclasses.is_dataclass(kind):
        _check_type(isinstance(value, dict), "a table", value, spec, path)
        return build_dataclass(cast(type[Any], kind), value, path)
    if get_origin(kind) in (list, tuple):
        return _convert_sequence(kind, value, spec, path)
    if kind is float or kind is int:
        return _convert_number(kind, value, spec, path)
    if kind is bool:
        _check_type(isinstance(value, bool), "true or false", value, spec, path)
        return value
    if not issubclass(kind, (str, Path)):
        raise TypeError(f"settings of type {kind} cannot be read: {'.'.join(path)}")
    return _convert_text(kind, value, spec, path)


def _convert_sequence(kind: Any, value: Any, spec: Field, path: KeyPath) -> Any:
    items = get_args(kind)
    length = None if get_origin(kind) is list or items[-1] is ... else len(items)
    expected = "a list" if length is None else f"a list of {length}"
    is_valid = isinstance(value, list) and length in (None, len(value))
    _check_type(is_valid, expected, value, spec, path)
    is_table = dataclasses.is_dataclass(items[0])
    return get_origin(kind)(
        _convert(items[0], item, spec, (*path, f"[{index}]") if is_table else path)
        for index, item in enumerate(value)
    )


def _convert_number(kind: type[Any], value: Any, spec: Field, path: KeyPath) -> Any:
    allowed = (int, float) if kind is float else (int,)
    is_number = isinstance(value, allowed) and not isinstance(value, bool)
    expected = "a number" if kind is float else "a whole number"
    expected += f", {spec.range_text}" if spec.range_text else ""
    _check_type(is_number, expected, value, spec, path)
    if isinstance(value, float) and not math.isfinite(value):
        raise FieldError(path, f"{value} is not allowed; give a finite number{spec.hint}")
    if value < spec.minimum or value > spec.maximum or value <= spec.exclusive_minimum:
        text = format_value(value)
        raise FieldError(path, f"{text} is out of range; give {spec.range_text}{spec.hint}")
    try:
        return kind(value)
    except OverflowError as error:
        raise FieldError(path, "is too large for a number; shorten it") from error


def _convert_text(kind: type[Any], value: Any, spec: Field, path: KeyPath) -> Any:
    _check_type(isinstance(value, str), "text in double quotes", value, spec, path)
    choices = spec.choices or (tuple(kind) if issubclass(kind, StrEnum) else ())
    if choices and value not in choices:
        text = format_value(value)
        raise FieldError(path, f"{text} is not a choice; {suggest_choice(value, choices)}")
    if spec.pattern and not re.fullmatch(spec.pattern, value):
        raise FieldError(path, f"{format_value(value)} is not valid; give {spec.pattern_name}")
    if "\0" in value:  # no path, address or name can hold it
        raise FieldError(path, "the character \\u0000 is not allowed; remove it")
    if kind is Path and not value:  # it would mean the current folder
        raise FieldError(path, "is empty; give a path, or leave the key out")
    if kind is Path and value.startswith("~"):
        raise FieldError(path, f"{format_value(value)}: write the home folder instead of ~")
    return kind(value)


def _check_type(is_valid: bool, expected: str, value: Any, spec: Field, path: KeyPath) -> None:
    if not is_valid:
        text = format_value(value)
        raise FieldError(path, f"{text} is the wrong type; give {expected}{spec.hint}")


def format_value(value: Any) -> str:
    """Format a parsed value briefly, about as a file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        text = json.dumps(value, ensure_ascii=False)
        return text if len(text) <= 60 else f'{text[:57]}..."'
    if isinstance(value, dict):
        return "a table"
    return f"a list of {len(value)}" if isinstance(value, list) else _format_number(value)


def _format_number(value: Any) -> str:
    # Python refuses to print whole numbers of thousands of digits.
    is_long = isinstance(value, int) and value.bit_length() > 128
    return "a number of too many digits" if is_long else str(value)


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return "did you mean" with the known name that is alike, or the list of all."""
    names = list(known)
    return _did_you_mean(name, names) or _list_names(names)


def suggest_choice(name: str, choices: Iterable[str]) -> str:
    """Return the list of all choices, after "did you mean" if one is alike."""
    names = list(choices)
    return " ".join(filter(None, (_did_you_mean(name, names), _list_names(names))))


def _did_you_mean(name: str, names: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f"did you mean `{close[0]}`?" if close else ""


def _list_names(names: Sequence[str]) -> str:
    return f"known here: {', '.join(names) or 'none'}"


def find_key_lines(text: str) -> dict[KeyPath, int]:
    """Find the first line (from 1) of every key and table of a valid TOML text.

    `tomllib` does not give line numbers. Dotted keys are tuples; "[1]" is the second table of a
    list.
    """
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    list_lengths: dict[KeyPath, int] = {}
    for number, statement in _split_statements(text):
        parsed = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            table = _header_path(parsed, list_lengths)
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


def _header_path(header: Any, list_lengths: dict[KeyPath, int]) -> KeyPath:
    """Return a table's path from its parsed header, which nests exactly one key per level.

    Args:
        list_lengths: Number of tables in each list so far; a new one is counted.
    """
    path: KeyPath = ()
    while header:
        key, header = next(iter(header.items()))
        path = (*path, key)
        if isinstance(header, list):
            header = header[0]
            list_lengths[path] = list_lengths.get(path, 0) + 1
        if path in list_lengths:
            path = (*path, f"[{list_lengths[path] - 1}]")
    return path


def _key_paths(parsed: dict[str, Any]) -> Iterator[KeyPath]:
    for key, value in parsed.items():
        yield (key,)
        if isinstance(value, dict):
            yield from ((key, *rest) for rest in _key_paths(value))


SCHEMA_VERSION = 1
# Much longer than any TOML file of kinect-vo.
MAX_FILE_BYTES = 1_000_000


def _accept(_: object) -> None:
    """Raise nothing."""


def read_toml(path: Path, kind: type[T], check: Callable[[T], None] = _accept) -> T:
    """Read a file into the dataclass `kind`. A Path is kept as it is written in the file.

    Args:
        check: A further check, which raises a FieldError.

    Raises:
        InputError: The file is invalid. The message is ``FILE:LINE: key `a.b`: reason; action``.
    """
    return parse_toml(read_toml_text(path), str(path), kind, check)


def read_toml_text(path: Path) -> str:
    """Read the text of a TOML file. Raises InputError."""
    return read_input_text(path, "name a TOML file", MAX_FILE_BYTES)


def parse_toml(text: str, name: str, kind: type[T], check: Callable[[T], None] = _accept) -> T:
    """Parse a TOML text as `read_toml` does; error messages start with `name`.

    Args:
        check: Is called with the result; raises a FieldError for values that make no sense.
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
        result = build_dataclass(kind, {k: v for k, v in table.items() if k != "schema"})
        check(result)
    except FieldError as error:
        line = _nearest_line(find_key_lines(text), error.path)
        location = f"{name}:{line}" if line else name
        key = f"key `{'.'.join(error.path).replace('.[', '[')}`: " if error.path else ""
        raise InputError(f"{location}: {key}{error}") from error.__cause__
    return result


def _nearest_line(lines: Mapping[KeyPath, int], path: KeyPath) -> int:
    """Return the line of a key, or of the table that it is missing in; 0 without either."""
    return next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 0)


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
