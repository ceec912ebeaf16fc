"""Copy of the program for the service: a virtual environment below /opt.

A service with DynamicUser and ProtectHome sees neither /root nor /home, where checkouts are.
Nothing is downloaded: the running program and its packages are copied.
"""

import compileall
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import drivers
from drivers.core import UserFacingError
from drivers.core.folders import SOURCE_PACKAGES

DISTRIBUTION_NAME = "kinect-vo"
# These files of a checkout point back to it.
CHECKOUT_METADATA_FILES = ("direct_url.json", "uv_build.json", "uv_cache.json")
PROGRAM_FOLDER = Path("opt/kinect-vo")
SCRIPT_PATH = PROGRAM_FOLDER / "bin" / "kinect-vo"
DIGEST_FILE = "installed.txt"
# The unit hides these folders from the service or replaces them.
HIDDEN_FOLDERS = tuple(Path(name) for name in ("/home", "/root", "/run/user", "/tmp", "/var/tmp"))
CHECK_TIMEOUT_S = 120.0

_SCRIPT_TEMPLATE = """\
#!/{python}
from vo_service.__main__ import main

main()
"""


def runtime_distributions() -> list[Distribution]:
    """Return kinect-vo and its installed requirements, with extras, in order of name."""
    by_name: dict[str, Distribution] = {}
    pending = [DISTRIBUTION_NAME]
    while pending:
        name = re.sub(r"[-_.]+", "-", pending.pop()).lower()
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


def install_program(root: Path, on_progress: Callable[[str], None]) -> bool:
    """Copy the running program to `root`/opt/kinect-vo.

    An old copy stays until the new one is complete and has run once.

    Returns:
        False if the same program is already installed.

    Raises:
        UserFacingError: The service could not run the copy.
        OSError: A file cannot be written.
    """
    target = root / PROGRAM_FOLDER
    if Path(sys.prefix).resolve() == target.resolve():
        return False
    python = _check_python()
    files = [pair for package in runtime_distributions() for pair in list_files(package)]
    digest = _files_digest(files)
    if (target / DIGEST_FILE).is_file() and (target / DIGEST_FILE).read_text() == digest:
        return False
    new = target.with_name(f".{target.name}.new")
    shutil.rmtree(new, ignore_errors=True)
    try:
        _create_environment(new, python, files, on_progress)
        (new / DIGEST_FILE).write_text(digest)
        _check_that_it_runs(new)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    _replace_folder(new, target)
    return True


def remove_program(root: Path) -> bool:
    """Remove the copy; returns False if there is none. Raises OSError."""
    target = root / PROGRAM_FOLDER
    if not target.exists():
        return False
    shutil.rmtree(target)
    return True


def _check_python() -> Path:
    """Return the base Python. Raises UserFacingError if a service cannot run it."""
    python = Path(os.path.realpath(sys.executable))
    hidden = [folder for folder in HIDDEN_FOLDERS if python.is_relative_to(folder)]
    inaccessible = [folder for folder in python.parents if not folder.stat().st_mode & 0o001]
    if hidden or inaccessible:
        raise UserFacingError(
            f"{python}: a service cannot run a Python below {(hidden + inaccessible)[0]}; set up "
            "the checkout with Debian's: KINECT_VO_PYTHON=/usr/bin/python3 scripts/setup.sh"
        )
    return python


def _files_digest(files: list[tuple[Path, Path]]) -> str:
    """Return a digest line that changes with any file and with the Python version."""
    digest = hashlib.sha256(sys.version.encode())
    for source, relative_path in files:
        state = source.stat()
        digest.update(f"{relative_path} {state.st_size} {state.st_mtime_ns}\n".encode())
    return f"{DISTRIBUTION_NAME} {digest.hexdigest()}\n"


def _create_environment(
    folder: Path, python: Path, files: list[tuple[Path, Path]], on_progress: Callable[[str], None]
) -> None:
    """Create a virtual environment (PEP 405) with these files."""
    binaries = folder / "bin"
    binaries.mkdir(parents=True)
    for name in ("python", "python3"):
        (binaries / name).symlink_to(python)
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    (folder / "pyvenv.cfg").write_text(
        f"home = {python.parent}\ninclude-system-site-packages = false\nversion = {version}\n"
    )
    packages = folder / "lib" / f"python{version}" / "site-packages"
    on_progress("copying")
    for source, relative_path in files:
        _copy_file(source, packages / relative_path)
    script = binaries / SCRIPT_PATH.name
    script.write_text(_SCRIPT_TEMPLATE.format(python=PROGRAM_FOLDER / "bin" / "python3"))
    script.chmod(0o755)
    # The service cannot write there, so Python could not store compiled files later.
    on_progress("compiling")
    installed_path = str(Path("/") / PROGRAM_FOLDER / packages.relative_to(folder))
    compileall.compile_dir(
        packages, quiet=2, stripdir=str(packages), prependdir=installed_path, workers=0
    )


def _copy_file(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    state = source.stat()
    os.utime(target, ns=(state.st_atime_ns, state.st_mtime_ns))
    target.chmod(0o755 if state.st_mode & 0o100 else 0o644)


def _check_that_it_runs(folder: Path) -> None:
    """Raise UserFacingError unless the copy runs."""
    command = [str(folder / "bin" / "python3"), "-I", str(folder / "bin" / SCRIPT_PATH.name)]
    process = subprocess.run(
        [*command, "run", "--help"],
        capture_output=True,
        text=True,
        timeout=CHECK_TIMEOUT_S,
        check=False,
    )
    if process.returncode != 0:
        last_line = (process.stderr.strip().splitlines() or ["no output"])[-1]
        raise UserFacingError(
            f"the copy in {folder} does not run ({last_line}); set up the checkout again with "
            "scripts/setup.sh and install again"
        )


def _replace_folder(new: Path, target: Path) -> None:
    """Replace the old folder with the new one."""
    old = target.with_name(f".{target.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if target.exists():
        target.rename(old)
    new.rename(target)
    shutil.rmtree(old, ignore_errors=True)
