"""Which installed packages the program consists of, and their files."""

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import vo_service
from drivers.errors import UserFacingError
from vo_service.folders import PACKAGES

PROGRAM = "kinect-vo"
# Of a checkout: they point back to it.
CHECKOUT_FILES = ("direct_url.json", "uv_build.json", "uv_cache.json")


def runtime_distributions() -> list[Distribution]:
    """kinect-vo and everything that it needs, with the extras that are installed, by name."""
    found: dict[str, Distribution] = {}
    waiting = [PROGRAM]
    while waiting:
        name = _normalised(waiting.pop())
        if name in found:
            continue
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:  # for another platform, or an extra that was left out
            continue
        waiting += _requirements(found[name], with_extras=name == PROGRAM)
    return [found[name] for name in sorted(found)]


def files_of(package: Distribution) -> Iterator[tuple[Path, Path]]:
    """(where a file is, where it belongs below site-packages), compiled Python left out.

    Scripts are left out too: they name the Python of the folder that they were installed in.
    Raises UserFacingError for a package whose files are not listed.
    """
    if package.name == PROGRAM:
        yield from _own_files(package)
        return
    if package.files is None:
        raise UserFacingError(
            f"{package.name}: its files are not listed, so it cannot be copied; set up the "
            "checkout with scripts/setup.sh and install from there"
        )
    for file in package.files:
        if ".." not in file.parts and file.suffix != ".pyc":
            yield Path(str(file.locate())), Path(*file.parts)


def _own_files(package: Distribution) -> Iterator[tuple[Path, Path]]:
    """The packages from where they are, which may be a checkout, and what `pip` knows of them."""
    source = Path(vo_service.__file__).parents[1]
    for name in PACKAGES:
        for path in sorted((source / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path, path.relative_to(source)
    for file in package.files or ():
        if file.parts[0].endswith(".dist-info") and file.name not in CHECKOUT_FILES:
            yield Path(str(file.locate())), Path(*file.parts)


def _requirements(package: Distribution, *, with_extras: bool) -> list[str]:
    """Names of what it needs; of a condition other than an extra, being installed is the proof."""
    names = []
    for requirement in package.requires or ():
        name, _, marker = requirement.partition(";")
        if with_extras or "extra" not in marker:
            names.append(re.split(r"[^A-Za-z0-9._-]", name.strip(), maxsplit=1)[0])
    return names


def _normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
