"""Print the locked wheels that a robot needs as pip requirements with hashes, one per line.

Usage: locked_wheels.py MACHINE PYTHON [EXTRA...], such as: locked_wheels.py aarch64 3.11 rerun
"""

import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from scripts.check_lock import TARGETS, Table, Target, compatible_wheels, runtime_packages

LOCK_FILE = Path(__file__).resolve().parent.parent / "uv.lock"


def format_requirements(
    packages: Sequence[Table], target: Target, extras: Iterable[str]
) -> Iterator[str]:
    """Yield name, version and hashes of the wheels that `target` can install, without markers.

    Args:
        packages: All locked packages.
        target: Processor and Python.
        extras: Extras of the project.
    """
    for package in runtime_packages(packages, target, extras):
        hashes = [f"--hash={wheel['hash']}" for wheel in compatible_wheels(package, target)]
        yield " ".join([f"{package['name']}=={package['version']}", *hashes])


def main(machine: str, python: str, *extras: str) -> None:
    """Print the requirements of a machine, a Python version and extras."""
    target = next(t for t in TARGETS if (t.machine, t.minor) == (machine, python))
    packages = tomllib.loads(LOCK_FILE.read_text(encoding="utf-8"))["package"]
    for line in format_requirements(packages, target, extras):
        print(line)


if __name__ == "__main__":
    main(*sys.argv[1:])
