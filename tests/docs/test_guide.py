"""What the guide tells a reader to type does what it says.

Blocks of Python run in `tests/examples/test_examples.py`, against a service.
"""

import os
import shlex
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import pytest

from tests import forked_process
from tests.docs.blocks import ROOT, Block, blocks_of, guide_blocks
from vo_service.cli.command_line import COMMANDS, make_parser
from vo_service.config import read_config

REASONS = {
    "half a minute of rendering",
    "a minute",
    "installs packages",
    "minutes",
    "minutes of rendering",
    "needs ROS 2",
    "needs a bag",
    "needs a recording of a board",
    "needs a robot",
    "needs a running service",
    "needs a sensor",
    "needs an incident",
    "needs an interactive shell",
    "network",
    "root",
    "until Ctrl-C",
}
# Words of the shell before a program and after its arguments.
BEFORE, AFTER = {"sudo", "--", "&&", "do", "$("}, {")", ";", "&&", "|"}
README = ROOT / "README.md"
SHELL = guide_blocks("sh")
RUN = [block for block in SHELL if not block.not_run]
CONFIGURATION = guide_blocks("toml")


def block_id(block: Block) -> str:
    return f"{block.page}:{block.line}"


def command_lines(block: Block) -> Iterator[list[str]]:
    """The arguments of each line of shell, without comments."""
    for line in block.code.replace("\\\n", " ").splitlines():
        line = line.replace("$(", " $( ").replace(");", " ) ;").replace("; done", " ; done")
        if words := shlex.split(line, comments=True):
            yield words


def test_each_block_that_is_not_run_has_a_known_reason() -> None:
    reasons = {block.not_run for block in SHELL + guide_blocks("python") if block.not_run}
    assert reasons <= REASONS


@pytest.mark.parametrize("block", [*SHELL, *blocks_of(README)], ids=block_id)
def test_every_command_in_the_guide_exists_with_its_options(block: Block) -> None:
    if block.language != "sh":
        return
    for words in command_lines(block):
        for number, word in enumerate(words):
            if word.split("/")[-1] == "kinect-vo" and (not number or words[number - 1] in BEFORE):
                call = list(takewhile(lambda word: word not in AFTER, words[number + 1 :]))
                assert call[0] in COMMANDS, call
                make_parser(call[:1]).parse_args(call)


@pytest.fixture(scope="module")
def desk(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reader's folder: with a recording, and what earlier blocks of the guide have made."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "recordings").mkdir()
    (folder / "recordings" / "desk").symlink_to(recording)
    return folder


@pytest.mark.subprocess
@pytest.mark.parametrize("block", RUN, ids=block_id)
def test_the_commands_of_a_block_run(block: Block, desk: Path, tmp_path: Path) -> None:
    # Shorter than in the text. A page begins in a new folder, beside the recording.
    folder = desk / Path(block.page).stem
    folder.mkdir(exist_ok=True)
    if not (folder / "recordings").exists():
        (folder / "recordings").symlink_to(desk / "recordings")
    for program, *arguments in command_lines(block):
        assert program == "kinect-vo"
        short = ["0.3" if word == "5" else word for word in arguments]
        done = forked_process.run(
            [*forked_process.KINECT_VO, *short],
            cwd=folder,
            env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
        )
        assert done.returncode == 0, (short, done.stderr)


@pytest.mark.parametrize("block", CONFIGURATION, ids=block_id)
def test_every_configuration_in_the_guide_is_accepted(block: Block, tmp_path: Path) -> None:
    file = tmp_path / "kinect.toml"
    file.write_text(block.code)
    read_config(file)
