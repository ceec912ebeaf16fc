"""Run the commands of docs/results again, and write their figures into the data and the pages.

Each page of docs/results has its figures in a JSON file beside it: for each result the command,
the date, the commit, the machine and a table. The blocks of a page between the comments
`result: NAME` and `end`, and the plots, are written from these data; `--pages` does only that.

The commands run in turn, except those marked `by_hand`, which take hours or print several tables.
KEPT/results.json has the output of each command that has run. A command that has a result there is
not run again; remove KEPT to measure everything anew. A benchmark whose exit code 1 says that a
limit was exceeded has a result.

`kinect-vo` and `python` are those of this environment. Names of recordings are folders in the
folder of `--data`, or of KINECT_VO_DATA. Nothing else should run on the computer meanwhile.
"""

import argparse
import os
import platform
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path

from benchmarks.console_tables import read_tables
from benchmarks.harness import Json, ResultCache, option
from benchmarks.result_pages import PAGES, ResultData, read_results, write_page, write_results
from drivers.core import InputError, UserFacingError
from vo_service.terminal import Terminal

ROOT = Path(__file__).resolve().parents[1]


@option("folder", metavar="KEPT", nargs="?", type=Path, help="folder of results")
@option("--data", type=Path, help="folder of the recordings")
@option("--only", nargs="+", default=[], help="only commands with one of the words")
@option("--list", action="store_true", help="print the commands and run nothing")
@option("--pages", action="store_true", help="write the pages and run nothing")
def main(args: argparse.Namespace) -> int:
    """Run the commands, write data and pages; return 1 if a command fails."""
    files = sorted(PAGES.glob("*.json"))
    commands = [
        result.command
        for file in files
        for result in read_results(file)
        if not result.by_hand
        and (not args.only or any(word in result.command for word in args.only))
    ]
    if args.list:
        print(*commands, sep="\n")
        return 0
    if not (args.pages or args.folder):
        raise InputError("name a folder for the results: python -m benchmarks results KEPT")
    commands = [] if args.pages else commands
    done = run_commands(commands, args.folder, args.data or _data_folder()) if commands else {}
    for file in files:
        write_results(file, [update(result, done) for result in read_results(file)])
        write_page(file)
    return 0 if len(done) == len(set(commands)) else 1


def update(data: ResultData, done: Mapping[str, Json]) -> ResultData:
    """Return a result with the figures of its command, if that has run."""
    run = done.get(data.command)
    if run is None:
        return data
    columns, rows = read_tables(run["output"])
    made = {name: run[name] for name in ("date", "commit", "machine")}
    return replace(data, **made, columns=columns, rows=rows)


def run_commands(commands: Iterable[str], folder: Path, data: Path) -> dict[str, Json]:
    """Run the commands that have no result yet; return the results by command.

    A command that fails has none; its error is printed.
    """
    cache, terminal, results = ResultCache(folder), Terminal(), {}
    for command in commands:
        try:
            with terminal.busy(command):
                results[command] = cache.get_or_run(command, partial(run, command, data))
        except UserFacingError as error:
            print(f"error: {error}", file=sys.stderr)
    return results


def run(command: str, data: Path) -> Json:
    """Run a command in the folder of the project. Raises UserFacingError if it fails."""
    words = [_find_recording(word, data) for word in shlex.split(command)]
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    begin_s = time.monotonic()
    done = subprocess.run(
        words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=False
    )
    if done.returncode > 1 or not done.stdout:
        raise UserFacingError(f"exit code {done.returncode}: {command}")
    return {
        "output": done.stdout.replace(f"{data}/", ""),
        "seconds": round(time.monotonic() - begin_s, 1),
        "date": date.today().isoformat(),
        "commit": _commit(),
        "machine": _machine(),
    }


def _find_recording(word: str, data: Path) -> str:
    return str(data / word) if re.fullmatch(r"\w+", word) and (data / word).is_dir() else word


def _commit() -> str:
    command = ["git", "rev-parse", "--short", "HEAD"]
    with suppress(FileNotFoundError):  # a copy of the project on a computer without git
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if commit := done.stdout.strip():
            return commit
    return "no commit"


def _machine() -> str:
    """The number of processors, their model, and the system."""
    model = re.search(r"(?m)^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text())
    system = platform.freedesktop_os_release()["PRETTY_NAME"]
    return f"{os.cpu_count()} processors ({model[1] if model else platform.machine()}, {system})"


def _data_folder() -> Path:
    folder = os.environ.get("KINECT_VO_DATA")
    if folder is None:
        raise InputError("name the folder of the recordings: --data FOLDER, or set KINECT_VO_DATA")
    return Path(folder)
