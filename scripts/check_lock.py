"""Check, without installing anything, that the lock file resolves to wheels only.

A robot's board has no compiler and no time to build: every package that the project needs (its
extras and development groups included) must have a wheel for each processor and each Python.
"""

import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, product
from pathlib import Path
from typing import Any

from packaging.markers import Marker
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

Table = Mapping[str, Any]

MACHINES = ("x86_64", "aarch64")
PYTHON_VERSIONS = ("3.11.2", "3.12.0", "3.13.0")  # 3.11.2 is Debian 12's own
GLIBC_MINOR = 36  # glibc 2.36, Debian 12
MIN_GLIBC_MINOR = 5  # manylinux_2_5, the first of its kind (PEP 600)


@dataclass(frozen=True)
class Target:
    """A processor and a CPython on Debian 12."""

    machine: str
    python: str

    def __str__(self) -> str:
        return f"Python {self.minor} on {self.machine}"

    @property
    def minor(self) -> str:
        """The Python version without its patch number."""
        return self.python.rpartition(".")[0]

    @property
    def markers(self) -> dict[str, str]:
        """Values of the PEP 508 markers there."""
        return {
            "implementation_name": "cpython",
            "implementation_version": self.python,
            "os_name": "posix",
            "platform_machine": self.machine,
            "platform_python_implementation": "CPython",
            "platform_release": "",
            "platform_system": "Linux",
            "platform_version": "",
            "python_full_version": self.python,
            "python_version": self.minor,
            "sys_platform": "linux",
        }

    @cached_property
    def tags(self) -> frozenset[Tag]:
        """Tags of the wheels that can be installed there."""
        version = tuple(int(part) for part in self.minor.split("."))
        interpreter = "cp" + self.minor.replace(".", "")
        platforms = [
            f"manylinux_2_{minor}_{self.machine}"
            for minor in range(GLIBC_MINOR, MIN_GLIBC_MINOR - 1, -1)
        ]
        native = cpython_tags(version, [interpreter], platforms)
        pure = compatible_tags(version, interpreter, platforms)
        return frozenset((*native, *pure))


TARGETS = tuple(Target(machine, python) for machine, python in product(MACHINES, PYTHON_VERSIONS))


def needed_packages(packages: Sequence[Table], target: Target) -> list[Table]:
    """List every locked package that `target` needs for the project, its extras and groups."""
    project = _project(packages)
    extras = list(project.get("optional-dependencies", {}))
    groups = project.get("dev-dependencies", {}).values()
    development = _applicable_dependencies(chain(*groups), target)
    return _resolve_packages(
        packages, [*_dependencies(project, extras, target), *development], target
    )


def runtime_packages(
    packages: Sequence[Table], target: Target, extras: Iterable[str]
) -> list[Table]:
    """List every locked package that `target` needs to run the project with these extras.

    Args:
        packages: All locked packages.
        target: Processor and Python.
        extras: Extras of the project.
    """
    return _resolve_packages(packages, _dependencies(_project(packages), extras, target), target)


def _project(packages: Sequence[Table]) -> Table:
    return next(p for p in packages if p["source"].keys() & {"editable", "virtual"})


def _resolve_packages(
    packages: Sequence[Table], pending: list[Table], target: Target
) -> list[Table]:
    """Resolve the packages of these dependencies and of theirs, sorted by name."""
    visited: list[Table] = []
    resolved: dict[tuple[str, str], Table] = {}
    while pending:
        dependency = pending.pop()
        if dependency in visited:
            continue
        visited.append(dependency)
        package = _find_locked_package(packages, dependency)
        resolved[package["name"], package["version"]] = package
        pending += _dependencies(package, dependency.get("extra", []), target)
    return [resolved[key] for key in sorted(resolved)]


def has_wheel(package: Table, target: Target) -> bool:
    """Whether a locked wheel of `package` can be installed on `target`."""
    return bool(compatible_wheels(package, target))


def compatible_wheels(package: Table, target: Target) -> list[Table]:
    """List the locked wheels of `package` that can be installed on `target`."""
    return [
        wheel
        for wheel in package.get("wheels", [])
        if not parse_wheel_filename(_file_name(wheel))[3].isdisjoint(target.tags)
    ]


def _file_name(wheel: Table) -> str:
    name: str = wheel["url"].rpartition("/")[2]
    return name


def find_problems(lock: Table) -> list[str]:
    """Report each package that a target would have to build from source."""
    return [
        f"{package['name']} {package['version']} has no wheel for {target}: "
        "constrain or replace it in pyproject.toml, then run uv lock"
        for target in TARGETS
        for package in needed_packages(lock["package"], target)
        if not has_wheel(package, target)
    ]


def main(path: Path) -> int:
    """Print the problems of the lock file, or what was checked; return 1 if there are problems."""
    lock = tomllib.loads(path.read_text(encoding="utf-8"))
    problems = find_problems(lock)
    for problem in problems:
        print(f"{path.name}: {problem}", file=sys.stderr)
    if not problems:
        for target in TARGETS:
            print(f"{target}: {len(needed_packages(lock['package'], target))} packages, all wheels")
    return 1 if problems else 0


def _dependencies(package: Table, extras: Iterable[str], target: Target) -> list[Table]:
    optional = package.get("optional-dependencies", {})
    dependencies = [package.get("dependencies", []), *(optional[extra] for extra in extras)]
    return _applicable_dependencies(chain(*dependencies), target)


def _applicable_dependencies(dependencies: Iterable[Table], target: Target) -> list[Table]:
    return [
        d for d in dependencies if "marker" not in d or Marker(d["marker"]).evaluate(target.markers)
    ]


def _find_locked_package(packages: Sequence[Table], dependency: Table) -> Table:
    """Find the package of a dependency, which has a version only if several are locked."""
    return next(
        package
        for package in packages
        if package["name"] == dependency["name"]
        and dependency.get("version", package["version"]) == package["version"]
    )


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parent.parent / "uv.lock"))
