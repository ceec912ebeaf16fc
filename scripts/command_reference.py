"""The commands of ``kinect-vo`` as Markdown, man page and completions, made from their parsers."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import shtab

from vo_service.cli.command_line import COMMAND_GROUPS, make_parser

INTRODUCTION = """\
# Commands

`scripts/write_reference.py` writes this page from the options of the commands. `kinect-vo COMMAND
--help` prints the same. [errors.md](errors.md) explains the exit codes and the keys of `--json`.

Every command also has `--verbose`: log progress to stderr.
"""


@dataclass(frozen=True)
class _Command:
    """A command, or an action of one.

    Attributes:
        name: Name as typed, such as ``kinect-vo config check``.
        help: One clause.
        options: Spelling and meaning of each option and argument.
        epilog: Examples and further explanations.
    """

    name: str
    help: str
    options: tuple[tuple[str, str], ...]
    epilog: str


def render_commands() -> str:
    """Render the page of Markdown."""
    commands: dict[str, list[_Command]] = {}
    for command in _commands():
        commands.setdefault(command.name.split()[1], []).append(command)
    page = INTRODUCTION
    for title, names in COMMAND_GROUPS.items():
        page += f"\n## {title[:1].upper()}{title[1:]}\n"
        page += "".join(_render_section(command) for name in names for command in commands[name])
    return page


def render_man_page() -> str:
    """Render the man page, in the man macros of troff."""
    parser = make_parser()
    lines = [
        '.\\" Written by scripts/write_reference.py.',
        ".TH KINECT-VO 1",
        ".SH NAME",
        "kinect-vo \\- visual odometry for RGB-D cameras",
        ".SH SYNOPSIS",
        ".B kinect-vo",
        ".I COMMAND",
        "[OPTION...]",
        ".SH DESCRIPTION",
        _troff(str(parser.description)),
        _troff("Every command also has --verbose: log progress to stderr."),
    ]
    for command in _commands():
        lines += [f'.SH "{command.name.upper()}"', _troff(f"{_sentence(command.help)}")]
        for spelling, meaning in command.options:
            lines += [".TP", f".B {_troff(spelling)}", _troff(meaning) or "\\&"]
        if command.epilog:
            lines += [".PP", ".nf", _troff(command.epilog), ".fi"]
    return "\n".join(lines) + "\n"


def render_completion(shell: str) -> str:
    """Render the completion of the command line for bash or zsh."""
    parser = make_parser()
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            action.help = None  # a suppressed help hides the commands from shtab as well
    completion: str = shtab.complete(parser, shell)
    return completion


def _render_section(command: _Command) -> str:
    level = "#" * (1 + len(command.name.split()))
    section = f"\n{level} {command.name}\n\n{_sentence(command.help)}\n"
    if command.options:
        rows = (f"| `{spelling}` | {_cell(meaning)} |" for spelling, meaning in command.options)
        section += "\n| option | meaning |\n|---|---|\n" + "\n".join(rows) + "\n"
    if command.epilog:
        section += f"\n```text\n{command.epilog}\n```\n"
    return section


def _commands() -> Iterator[_Command]:
    parser = make_parser()
    for name, command in _actions_of(parser):
        yield from _with_actions(f"{parser.prog} {name}", command, command.description or "")


def _with_actions(name: str, parser: argparse.ArgumentParser, help_text: str) -> Iterator[_Command]:
    options = tuple(
        (_spelling(action), (action.help or "") % {**vars(action), "prog": parser.prog})
        for action in parser._actions
        if not isinstance(action, argparse._SubParsersAction | argparse._HelpAction)
        and action.help != argparse.SUPPRESS
        and action.dest != "verbose"
    )
    yield _Command(name, help_text.rstrip("."), options, (parser.epilog or "").strip())
    helps = _helps_of_actions(parser)
    for action, sub in _actions_of(parser):
        yield from _with_actions(f"{name} {action}", sub, helps.get(action, ""))


def _actions_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _helps_of_actions(parser: argparse.ArgumentParser) -> dict[str, str]:
    return {
        choice.dest: choice.help or ""
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for choice in action._choices_actions
    }


def _spelling(action: argparse.Action) -> str:
    """Return an option with the name of its value, or the name of an argument."""
    choices = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else ""
    metavar = action.metavar or choices or action.dest.upper()
    value = metavar if isinstance(metavar, str) else " ".join(metavar)
    if action.nargs in ("*", "+"):
        value += "..."
    if not action.option_strings:
        return value
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {value}"


def _sentence(clause: str) -> str:
    return f"{clause[:1].upper()}{clause[1:].rstrip('.')}."


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _troff(text: str) -> str:
    """Escape text for troff, whose lines must not begin with a dot or an apostrophe."""
    escaped = text.replace("\\", "\\\\").replace("-", "\\-")
    return "\n".join(
        f"\\&{line}" if line[:1] in (".", "'") else line for line in escaped.split("\n")
    )
