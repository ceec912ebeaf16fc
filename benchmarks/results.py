"""Run the commands of docs/results again and write their output into the pages.

    python -m benchmarks results KEPT [--data FOLDER] [--only WORD...] [--list]

A page has blocks of `console`: a line `$ COMMAND  # DATE, COMMIT`, and the output of the command.
Each command runs in turn, and its block gets the new output, date and commit. KEPT/results.jsonl
has one JSON object for each command that has run: command, exit code, seconds, output. A command
that has a result there is not run again; remove KEPT to measure everything anew. A benchmark whose
exit code 1 says that a limit was exceeded has a result.

`kinect-vo` and `python` are those of this environment. Names of recordings are folders in the
folder of `--data`, or of KINECT_VO_DATA. Nothing else should run on the computer meanwhile.
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import atomic_write
from vo_service.terminal import Terminal

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "results"
RESULTS_FILE = "results.jsonl"
# The command, over several lines if they end with a backslash, its comment, and the output.
BLOCK = re.compile(r"(?ms)^```console\n\$ (?P<command>(?:[^\n]*\\\n)*[^\n#]*)(?:#[^\n]*)?\n.*?^```")


@dataclass(frozen=True)
class CommandResult:
    """A command that has run."""

    command: str
    exit_code: int
    seconds: float
    made: str
    output: str

    @property
    def has_failed(self) -> bool:
        """Whether it printed no result."""
        return self.exit_code > 1 or not self.output


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", metavar="KEPT", type=Path, help="folder of the results")
    parser.add_argument("--data", type=Path, help="folder of the recordings")
    parser.add_argument("--only", nargs="+", default=[], help="only commands with one of the words")
    parser.add_argument("--list", action="store_true", help="print the commands and run nothing")


def main(args: argparse.Namespace) -> int:
    """Run the commands and write the pages; return 1 if a command fails."""
    pages = sorted(PAGES.glob("*.md"))
    commands = [
        command
        for page in pages
        for command in find_commands(page.read_text())
        if not args.only or any(word in command for word in args.only)
    ]
    if args.list:
        print(*commands, sep="\n")
        return 0
    results = run_commands(commands, args.folder, args.data or _data_folder())
    for page in pages:
        text = page.read_text()
        new_text = write_outputs(text, results)
        if new_text != text:
            atomic_write(page, new_text.encode())
    failed = [result for result in results if result.has_failed]
    for result in failed:
        print(f"error: exit code {result.exit_code}: {result.command}", file=sys.stderr)
    return 1 if failed else 0


def find_commands(text: str) -> list[str]:
    """Return the commands of a page, in order, each on one line."""
    return [_join_lines(match["command"]) for match in BLOCK.finditer(text)]


def write_outputs(text: str, results: Iterable[CommandResult]) -> str:
    """Return the page with the outputs of the commands that succeeded."""
    by_command = {result.command: result for result in results if not result.has_failed}

    def replace(match: re.Match[str]) -> str:
        result = by_command.get(_join_lines(match["command"]))
        if result is None:
            return match[0]
        command = match["command"].rstrip()
        return f"```console\n$ {command}  # {result.made}\n{result.output.rstrip()}\n```"

    return BLOCK.sub(replace, text)


def run_commands(commands: Iterable[str], folder: Path, data: Path) -> list[CommandResult]:
    """Run the commands that have no good result yet; add each result to the file of the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / RESULTS_FILE
    kept = {result.command: result for result in _read(file) if not result.has_failed}
    terminal, results = Terminal(), []
    for command in commands:
        result = kept.get(command)
        if result is None:
            with terminal.busy(command):
                result = run(command, data)
            with file.open("a") as stream:
                stream.write(f"{json.dumps(asdict(result))}\n")
            terminal.write_line(f"exit code {result.exit_code}, {result.seconds} s: {command}")
        results.append(result)
    return results


def run(command: str, data: Path) -> CommandResult:
    """Run a command in the folder of the project."""
    words = [_find_recording(word, data) for word in shlex.split(command)]
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    begin_s = time.monotonic()
    done = subprocess.run(
        words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=False
    )
    seconds = round(time.monotonic() - begin_s, 1)
    output = done.stdout.replace(f"{data}/", "")
    return CommandResult(command, done.returncode, seconds, _made(), output)


def _find_recording(word: str, data: Path) -> str:
    return str(data / word) if re.fullmatch(r"\w+", word) and (data / word).is_dir() else word


def _made() -> str:
    """The date, and the commit of the project."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    commit = ""
    with suppress(FileNotFoundError):  # a copy of the project on a computer without git
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        commit = done.stdout.strip()
    return f"{date.today().isoformat()}, {commit or 'no commit'}"


def _join_lines(command: str) -> str:
    return " ".join(command.replace("\\\n", " ").split())


def _data_folder() -> Path:
    folder = os.environ.get("KINECT_VO_DATA")
    if folder is None:
        raise InputError("name the folder of the recordings: --data FOLDER, or set KINECT_VO_DATA")
    return Path(folder)


def _read(file: Path) -> list[CommandResult]:
    if not file.exists():
        return []
    try:
        return [CommandResult(**json.loads(line)) for line in file.read_text().splitlines()]
    except (OSError, TypeError, ValueError) as error:
        raise InputError(f"{file}: cannot read it ({error}); name another folder") from error
