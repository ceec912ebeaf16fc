"""The simulated libusb-1.0: compiled once for each version of its sources."""

import hashlib
import shutil
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.folders import cache_folder

SONAME = "libusb-1.0.so.0"
SOURCES = Path(__file__).parent / "libusb"
_OPTIONS = (
    *("-std=gnu11", "-O2", "-g", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wno-missing-field-initializers"),
    *(f"-Wl,-soname,{SONAME}", "-Wl,-z,defs"),
)


@cache
def libusb_folder() -> Path:
    """Return the folder for LD_LIBRARY_PATH with the simulated library; compile it if needed.

    Raises:
        UserFacingError: There is no C compiler.
    """
    folder = cache_folder().resolve() / "kinect-simulator" / _fingerprint()
    if not (folder / SONAME).exists():
        _compile(folder)
    return folder


def simulated_library_path() -> str | None:
    """The LD_LIBRARY_PATH of processes that find the simulated library; None without a compiler."""
    try:
        return str(libusb_folder())
    except UserFacingError:
        return None


def _fingerprint() -> str:
    digest = hashlib.sha256(" ".join(_OPTIONS).encode())
    for file in sorted(SOURCES.iterdir()):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def compiler() -> str:
    """Path of the C compiler. Raises UserFacingError if there is none."""
    path = shutil.which("gcc") or shutil.which("cc")
    if path is None:
        raise UserFacingError("the Kinect simulator needs a C compiler: apt install gcc")
    return path


def _compile(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    # The library appears at once and complete: other processes may look for it at any time.
    with tempfile.TemporaryDirectory(dir=folder) as draft:
        library = Path(draft) / SONAME
        sources = [str(file) for file in sorted(SOURCES.glob("*.c"))]
        command = [compiler(), *_OPTIONS, "-o", str(library), *sources]
        subprocess.run(command, check=True)
        with suppress(FileExistsError):  # another process was faster, and may use it already
            (folder / SONAME).hardlink_to(library)
