"""Which installed packages the program consists of, and their files."""

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import vo_service
from drivers.core.errors import UserFacingError
from drivers.core.paths import SOURCE_PACKAGES

DISTRIBUTION_NAME = "kinect-vo"
# Of a checkout: they point back to it.
CHECKOUT_METADATA_FILES = ("direct_url.json", "uv_build.json", "uv_cache.json")


def runtime_distributions() -> list[Distribution]:
    """kinect-vo and everything that it needs, with the extras that are installed, by name."""
    found: dict[str, Distribution] = {}
    waiting = [DISTRIBUTION_NAME]
    while waiting:
        name = _normalize_name(waiting.pop())
        if name in found:
            continue
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:  # for another platform, or an extra that was left out
            continue
        waiting += _requirement_names(found[name], with_extras=name == DISTRIBUTION_NAME)
    return [found[name] for name in sorted(found)]


def list_files(package_distribution: Distribution) -> Iterator[tuple[Path, Path]]:
    """(where a file is, where it belongs below site-packages), compiled Python left out.

    Scripts are left out too: they name the Python of the folder that they were installed in.
    Raises UserFacingError for a package whose files are not listed.
    """
    if package_distribution.name == DISTRIBUTION_NAME:
        yield from _list_own_files(package_distribution)
        return
    if package_distribution.files is None:
        raise UserFacingError(
            f"{package_distribution.name}: its files are not listed, so it cannot be copied; set up the "
            "checkout with scripts/setup.sh and install from there"
        )
    for file in package_distribution.files:
        if ".." not in file.parts and file.suffix != ".pyc":
            yield Path(str(file.locate())), Path(*file.parts)


def _list_own_files(package: Distribution) -> Iterator[tuple[Path, Path]]:
    """The packages from where they are, which may be a checkout, and what `pip` knows of them."""
    source = Path(vo_service.__file__).parents[1]
    for name in SOURCE_PACKAGES:
        for path in sorted((source / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path, path.relative_to(source)
    for file in package.files or ():
        if file.parts[0].endswith(".dist-info") and file.name not in CHECKOUT_METADATA_FILES:
            yield Path(str(file.locate())), Path(*file.parts)


def _requirement_names(package: Distribution, *, with_extras: bool) -> list[str]:
    """Names of what it needs; of a condition other than an extra, being installed is the proof."""
    names = []
    for requirement in package.requires or ():
        name, _, marker = requirement.partition(";")
        if with_extras or "extra" not in marker:
            names.append(re.split(r"[^A-Za-z0-9._-]", name.strip(), maxsplit=1)[0])
    return names


def _normalize_name(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
