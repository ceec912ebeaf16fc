"""Installed packages of the program, and their files."""

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import drivers
from drivers.core.errors import UserFacingError
from drivers.core.files import SOURCE_PACKAGES

DISTRIBUTION_NAME = "kinect-vo"
# These files of a checkout point back to it.
CHECKOUT_METADATA_FILES = ("direct_url.json", "uv_build.json", "uv_cache.json")


def runtime_distributions() -> list[Distribution]:
    """Return kinect-vo and its installed requirements, with extras, in order of name."""
    by_name: dict[str, Distribution] = {}
    pending = [DISTRIBUTION_NAME]
    while pending:
        name = _normalize_name(pending.pop())
        if name in by_name:
            continue
        try:
            by_name[name] = distribution(name)
        except PackageNotFoundError:  # for another platform, or an extra that is not installed
            continue
        pending += _requirement_names(by_name[name], with_extras=name == DISTRIBUTION_NAME)
    return [by_name[name] for name in sorted(by_name)]


def list_files(package_distribution: Distribution) -> Iterator[tuple[Path, Path]]:
    """Yield (path of a file, its path below site-packages) of a package.

    Compiled Python is left out, as are scripts, which name the Python of their own environment.

    Raises:
        UserFacingError: The package does not list its files.
    """
    if package_distribution.name == DISTRIBUTION_NAME:
        yield from _list_own_files(package_distribution)
        return
    if package_distribution.files is None:
        raise UserFacingError(
            f"{package_distribution.name}: cannot be copied, because it does not list its files; "
            "set up the checkout with scripts/setup.sh and install from there"
        )
    for file in package_distribution.files:
        if ".." not in file.parts and file.suffix != ".pyc":
            yield Path(str(file.locate())), Path(*file.parts)


def _list_own_files(package: Distribution) -> Iterator[tuple[Path, Path]]:
    """Yield our packages' files, which may be in a checkout, and pip's metadata of them."""
    source = Path(drivers.__file__).parents[1]
    for name in SOURCE_PACKAGES:
        for path in sorted((source / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path, path.relative_to(source)
    for file in package.files or ():
        if file.parts[0].endswith(".dist-info") and file.name not in CHECKOUT_METADATA_FILES:
            yield Path(str(file.locate())), Path(*file.parts)


def _requirement_names(package: Distribution, *, with_extras: bool) -> list[str]:
    """Return names of the requirements; other conditions than extras are not evaluated."""
    names = []
    for requirement in package.requires or ():
        name, _, marker = requirement.partition(";")
        if with_extras or "extra" not in marker:
            names.append(re.split(r"[^A-Za-z0-9._-]", name.strip(), maxsplit=1)[0])
    return names


def _normalize_name(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
