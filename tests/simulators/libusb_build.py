"""The stand-in for libusb-1.0, compiled once for as long as its sources stay the same."""

import hashlib
import shutil
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from drivers.core.errors import UserFacingError
from drivers.core.paths import cache_folder

SONAME = "libusb-1.0.so.0"
SOURCES = Path(__file__).parent / "libusb"
_OPTIONS = (
    *("-std=gnu11", "-O2", "-g", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wno-missing-field-initializers"),
    *(f"-Wl,-soname,{SONAME}", "-Wl,-z,defs"),
)


@cache
def libusb_folder() -> Path:
    """The folder to put into LD_LIBRARY_PATH: it holds the stand-in under libusb's own name.

    Raises UserFacingError where there is no C compiler.
    """
    folder = cache_folder().resolve() / "played-kinect" / _fingerprint()
    if not (folder / SONAME).exists():
        _compile(folder)
    return folder


def _fingerprint() -> str:
    digest = hashlib.sha256(" ".join(_OPTIONS).encode())
    for file in sorted(SOURCES.iterdir()):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def compiler() -> str:
    """The C compiler. Raises UserFacingError where there is none."""
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        raise UserFacingError("no C compiler to make the played Kinect with; apt install gcc")
    return found


def _compile(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    # Whoever looks for the library at this moment finds all of it or nothing, and for good.
    with tempfile.TemporaryDirectory(dir=folder) as draft:
        library = Path(draft) / SONAME
        sources = [str(file) for file in sorted(SOURCES.glob("*.c"))]
        command = [compiler(), *_OPTIONS, "-o", str(library), *sources]
        subprocess.run(command, check=True)
        with suppress(FileExistsError):  # somebody was faster, and may have it in use
            (folder / SONAME).hardlink_to(library)
