"""Checks of the systemd units on a booting computer: a Debian with systemd, in a container.

    sudo .venv/bin/python -m benchmarks boot [--tree DIR] [--mirror URL]

The first run creates the Debian with debootstrap (a minute or two). Each run boots it, installs the
service from this checkout with its own command, and runs the checks. The container shares the
network of this computer, so a subscriber outside receives the poses. A run takes about ten minutes.
Exit code 0 if all checks pass, 1 if one fails, 77 where no container can run.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.boot_checks import FIRST_BOOT, SECOND_BOOT
from benchmarks.boot_container import (
    BootedComputer,
    bootstrap_tree,
    running_container,
    running_listener,
    unsupported_reason,
)
from tests.ports import free_port

CHECKOUT = Path(__file__).parents[1]
COMMAND = CHECKOUT / ".venv" / "bin" / "kinect-vo"
EXIT_SKIPPED = 77
# Files that an earlier run may have left in the tree.
LEFTOVER_PATHS = (
    "opt/kinect-vo",
    "etc/kinect-vo",
    "srv/kinect-vo",
    "var/lib/private",
    "var/cache/private",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--tree", type=Path, default=Path("/var/tmp/kinect-vo-boot"))
    parser.add_argument("--mirror", default="http://deb.debian.org/debian")


def main(args: argparse.Namespace) -> int:
    """Boot twice and print the checks."""
    reason = unsupported_reason() or _python_mismatch()
    if reason:
        print(f"skipped: {reason}")
        return EXIT_SKIPPED
    bootstrap_tree(args.tree, args.mirror)
    _remove_leftovers(args.tree)
    port = free_port()
    failed = _run(args.tree, port, FIRST_BOOT) + _run(args.tree, port, SECOND_BOOT)
    print(f"{failed} of {len(FIRST_BOOT + SECOND_BOOT)} checks failed")
    return int(failed > 0)


def _run(tree: Path, port: int, checks: Sequence[Callable[[BootedComputer], str]]) -> int:
    """Boot and run checks; return the number that fail."""
    log = tree.with_name(f"{tree.name}.log")
    with running_container(tree, [CHECKOUT], log) as container, running_listener(port) as listener:
        computer = BootedComputer(container, tree, str(COMMAND), listener, port)
        return sum(not _run_check(check, computer) for check in checks)


def _run_check(check: Callable[[BootedComputer], str], computer: BootedComputer) -> bool:
    """Run a check, print a line, and return whether it passes."""
    name = check.__name__.replace("_", " ")
    begin_s = time.monotonic()
    try:
        outcome = check(computer)
    except (AssertionError, subprocess.SubprocessError) as error:
        print(f"FAILED  {name}: {error}", flush=True)
        print(
            "".join(f"        | {e['MESSAGE']}\n" for e in computer.journal_entries()[-12:]), end=""
        )
        return False
    print(f"ok      {name} ({time.monotonic() - begin_s:.0f} s): {outcome}", flush=True)
    return True


def _python_mismatch() -> str:
    """The container runs the checkout's own environment, so it needs the same Python."""
    python = Path(os.path.realpath(sys.executable))
    return "" if python == Path("/usr/bin/python3.11") else f"{python} is not Debian 12's Python"


def _remove_leftovers(tree: Path) -> None:
    for folder in LEFTOVER_PATHS:
        shutil.rmtree(tree / folder, ignore_errors=True)
    for unit in list((tree / "etc/systemd").rglob("kinect-vo*")):
        if unit.is_dir():
            shutil.rmtree(unit)
        elif unit.is_symlink() or unit.exists():
            unit.unlink()
