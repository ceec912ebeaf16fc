"""Requests: a frozen dataclass per command, from which its options are made.

A field is declared once, as in the configuration, by its type and an `Option`. An option that sets
a key of the configuration is made from the field of that key.
"""

import argparse
import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from drivers.core.config import Field, TypedField, typed_fields
from vo_service.config import Config, replace_key

# Of an `Option` in the metadata of a field. Options of several requests are in its type, Annotated.
_KEY = "option"
# Of an option without a limit of its own.
MAX_WHOLE_NUMBER = 9_999_999


@dataclass(frozen=True)
class Option(Field):
    """Option of a command; a list of values follows it, and a bool is true if it is given.

    Attributes:
        description: The help text.
        metavar: Name of the value, or of each of two values.
        parse: Parses a text, or raises ArgumentTypeError; None: the type and the limits do.
        allowed: The only values; None = any.
        noun: What a number is, for errors, such as "a length".
        is_repeated: Whether a value of a list has an option of its own.
        key: Key of the configuration that the option sets; "" = none.
    """

    metavar: str | tuple[str, str] | None = None
    parse: Callable[[str], Any] | None = None
    allowed: Iterable[str] | None = None
    noun: str = "a number"
    is_repeated: bool = False
    key: str = ""


@dataclass(frozen=True)
class Argument(Option):
    """Argument without a name, such as RECORDING."""


def option(
    text: str,
    default: Any = None,
    metavar: str | tuple[str, str] | None = None,
    parse: Callable[[str], Any] | None = None,
    **properties: Any,
) -> Any:
    """Declare an option as a field of a request, with its help text; `properties` of `Option`."""
    spec = Option(text, metavar=metavar, parse=parse, **properties)
    return dataclasses.field(default=default, metadata={_KEY: spec})


def flag(text: str) -> Any:
    """Declare an option without a value; a field of type bool."""
    return option(text, default=False)


def argument(
    text: str, metavar: str | None = None, default: Any = dataclasses.MISSING, **properties: Any
) -> Any:
    """Declare an argument without a name; it must be given if it has no default."""
    spec = Argument(text, metavar=metavar, **properties)
    return dataclasses.field(default=default, metadata={_KEY: spec})


def option_of(kind: type[Any], name: str, **differences: Any) -> Option:
    """Make an option from the field of a dataclass, with what differs for the command line."""
    spec = next(field.spec for field in typed_fields(kind) if field.name == name)
    return replace(Option(**vars(spec)), **differences)


def config_option(
    key: str, default: str = " (default: the config's)", **differences: Any
) -> Option:
    """Make the option that sets a key of the configuration, such as "odometry.method".

    Args:
        default: End of the help text, for what holds without the option.
    """
    table, _, name = key.partition(".")
    kind = next(field.kind for field in typed_fields(Config) if field.name == table)
    option = option_of(kind, name, key=key)
    return replace(option, **{"description": option.description + default} | differences)


@dataclass(frozen=True, kw_only=True)
class CommandRequest:
    """What every command is asked: whether to log progress."""

    verbose: bool = False


R = TypeVar("R", bound=CommandRequest)


def with_options(request: CommandRequest, config: Config) -> Config:
    """Return the configuration with the keys that the options of a request set.

    Raises:
        InputError: If a value is not valid.
    """
    for field in typed_fields(type(request)):
        value = getattr(request, field.name)
        if isinstance(field.spec, Option) and field.spec.key and value:
            config = replace_key(config, field.spec.key, value)
    return config


def add_options(parser: argparse.ArgumentParser, kind: type[CommandRequest]) -> None:
    """Add the options of a request; `verbose`, which all have, is added with the command."""
    declared = {field.name: field.metadata.get(_KEY) for field in dataclasses.fields(kind)}
    for field in typed_fields(kind):
        spec = declared[field.name] or field.spec
        if isinstance(spec, Option):
            _add_option(parser, field, spec)


def make_request(kind: type[R], args: argparse.Namespace) -> R:
    """Make the request of the parsed options."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        value = getattr(args, field.name)
        if value is not None:
            values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def _add_option(parser: argparse.ArgumentParser, field: TypedField, option: Option) -> None:
    default = None if field.default is dataclasses.MISSING else field.default
    settings: dict[str, Any] = {"help": option.description}
    if field.kind is bool:
        settings["action"] = "store_true"
    else:
        item = get_args(field.kind)[0] if get_origin(field.kind) is tuple else field.kind
        settings |= {"metavar": option.metavar, "type": option.parse or _parser_of(item, option)}
        settings |= {"default": default, "choices": option.allowed}
        settings |= _count_values(field, option)
    if isinstance(option, Argument):
        parser.add_argument(field.name, **settings)
    else:
        # PEP 8: a name that is a keyword of Python ends in an underscore.
        name = field.name.rstrip("_").replace("_", "-")
        parser.add_argument(f"--{name}", dest=field.name, **settings)


def _count_values(field: TypedField, option: Option) -> dict[str, Any]:
    """Return how many values `argparse` accepts."""
    if get_origin(field.kind) is tuple:
        if option.is_repeated:
            return {"action": "append", "default": None}
        length = len(get_args(field.kind)) if get_args(field.kind)[-1] is not ... else 0
        is_optional = isinstance(option, Argument) and not field.is_required
        return {"nargs": length or ("*" if is_optional else "+")}
    return {"nargs": "?"} if isinstance(option, Argument) and not field.is_required else {}


def _parser_of(item: type[Any], option: Option) -> Callable[[str], Any]:
    if item is int or item is float:
        return _limited_number_parser(item, option)
    return _parse_path if item is Path else str


def _parse_path(text: str) -> Path:
    """Parse a path. Refuse "", such as from an unset variable: it would mean the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: give a path")
    return Path(text)


def _limited_number_parser(kind: type[Any], option: Option) -> Callable[[str], Any]:
    """Make the parser of a number within the limits of an option."""
    low, high = option.minimum, option.maximum
    wanted = f"{low:g} to {high:g}" if high < math.inf else f"{low:g} or more"
    wanted += ", a whole number" if kind is int else ""
    high = min(high, MAX_WHOLE_NUMBER) if kind is int else high
    error = f"is not {option.noun}: give {wanted}"
    return number_parser(kind, lambda value: low <= value <= high, error)


def number_parser(
    kind: type[Any], is_valid: Callable[[float], bool], error: str
) -> Callable[[str], Any]:
    """Make the parser of a number; it raises ArgumentTypeError with the error for all else.

    A whole number has digits only, and no sign.
    """

    def parse(text: str) -> Any:
        try:
            value = kind(text) if kind is float or (text.isascii() and text.isdigit()) else math.nan
        except ValueError:
            value = math.nan
        if not is_valid(value):
            raise argparse.ArgumentTypeError(f"{text} {error}")
        return value

    return parse
