"""Every option that a message names exists in each command that can print the message."""

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from vo_service.cli.command_line import COMMANDS, make_parser

ROOT = Path(__file__).parents[3]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*[a-z0-9]")
OTHER_PROGRAMS = r"systemctl|groupadd|ScanNet's \.sens"
# Commands that print the messages below a path. For other paths one command with the option is
# enough.
RECORDING_COMMANDS = (
    *("replay", "convert", "reconstruct", "compare", "calibrate", "run", "record", "doctor"),
)
PRINTED_BY = {
    "drivers/bag/": RECORDING_COMMANDS,
    "drivers/recording": RECORDING_COMMANDS,
    "drivers/tum/": RECORDING_COMMANDS,
    "drivers/calibration.py": RECORDING_COMMANDS,
    "drivers/layouts/": RECORDING_COMMANDS,
    "drivers/openni2/": ("run", "record", "calibrate", "doctor"),
    "drivers/rectify.py": ("run", "record", "calibrate", "doctor"),
    "drivers/core/files.py": ("compare", "demo", "reconstruct"),
    "vo_service/outputs/zenoh/": ("run", "replay"),
    "vo_service/cli/devices.py": ("run", "record", "calibrate", "doctor"),  # a list for these
    "vo_service/tools/compare/": ("compare",),
    "vo_service/tools/calibration/": ("calibrate",),
    "vo_service/tools/doctor/": ("doctor",),
    "vo_service/tools/download/": ("download",),
    "vo_service/cli/calibrate_timing.py": ("calibrate",),
    "vo_service/cli/reconstruct_tracking.py": ("reconstruct",),
    "vo_service/cli/calibrate_learned.py": ("calibrate",),
    "vo_service/cli/calibrate_request.py": ("calibrate",),
    **{f"vo_service/cli/{n.replace('-', '_')}.py": (n,) for n in COMMANDS if n != "devices"},
}


@pytest.fixture(scope="module")
def of_command() -> dict[str, set[str]]:
    """The options of each command."""
    (commands,) = (a for a in make_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return {name: options(parser) for name, parser in commands.choices.items()}


def options(parser: argparse.ArgumentParser) -> set[str]:
    """All options of a command and of its actions."""
    found = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found.update(*map(options, action.choices.values()))
    return found


def texts(tree: ast.AST) -> Iterator[str]:
    """Yield each sentence of a module, with gaps for values; not its docstrings."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Call, ast.Return, ast.Assign, ast.Tuple, ast.Dict, ast.JoinedStr)):
            for child in ast.iter_child_nodes(node):
                if isinstance(child, ast.Constant) and isinstance(child.value, str):
                    yield child.value
        if isinstance(node, ast.JoinedStr):
            parts = [p.value if isinstance(p, ast.Constant) else "{}" for p in node.values]
            yield "".join(map(str, parts))


def named_options(path: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each option in the messages of a file, with the commands that must have it."""
    printers = next((found for part, found in PRINTED_BY.items() if path.startswith(part)), ())
    for text in texts(ast.parse((ROOT / path).read_text())):
        own_text = re.sub(rf"\b({OTHER_PROGRAMS}) [^;]*", "", text)
        own_text = re.sub(r" -- .*", "", own_text)  # handed on
        if " " not in own_text.strip():
            continue  # an argument of another program, or a declaration
        for sentence in re.split(r"(?=kinect-vo [a-z-]+)|[;()\n`]", own_text):
            command = re.match(r"kinect-vo ([a-z-]+)", sentence)
            is_known = command is not None and command[1] in COMMANDS
            for option in OPTION.findall(sentence):
                yield option, (command[1],) if command is not None and is_known else printers


FILES = sorted(
    str(file.relative_to(ROOT))
    for package in ("drivers", "vo_service")
    for file in (ROOT / package).rglob("*.py")
    if "--" in file.read_text()
)


@pytest.mark.parametrize("path", FILES)
def test_a_named_option_exists_where_it_is_named(
    path: str, of_command: dict[str, set[str]]
) -> None:
    anywhere = set().union(*of_command.values()) | {"--version"}
    for option, printers in named_options(path):
        for name in printers:
            assert option in of_command[name], f"{name} has no {option}"
        assert option in anywhere


def test_the_search_finds_the_options_of_messages() -> None:
    assert ("--camera-file", RECORDING_COMMANDS) in set(named_options("drivers/bag/calibration.py"))
    assert ("--timing", ("calibrate",)) in set(named_options("vo_service/types/estimate.py"))
