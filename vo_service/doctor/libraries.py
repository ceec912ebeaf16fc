"""Whether the native libraries are there, and which files they are."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.errors import UserFacingError
from vo_service.doctor.child import in_child
from vo_service.doctor.context import Context
from vo_service.doctor.finding import Finding, failed, passed

LIMIT_S = 10.0
PACKAGES = {
    "libfreenect.so.0.5": "libfreenect0.5",
    "libOpenNI2.so.0": "libopenni2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


@dataclass(frozen=True)
class Loaded:
    """What became of a library: the file that is in memory, or why there is none."""

    name: str
    file: str
    error: str


def load(names: Sequence[str]) -> list[Loaded]:
    """Load libraries into this process, in order, as the drivers do."""
    return [_load(name) for name in names]


def _load(name: str) -> Loaded:
    try:
        ctypes.CDLL(name)
    except OSError as error:
        return Loaded(name, "", str(error))
    # Not the file that a search would find: the one that the loader took.
    stem = name.partition(".so")[0] + ".so"
    lines = Path("/proc/self/maps").read_text().splitlines()
    files = [line.split(maxsplit=5)[5] for line in lines if "/" in line]
    return Loaded(name, next((file for file in files if Path(file).name.startswith(stem)), ""), "")


class Libraries:
    """The libraries of one kind of camera."""

    name = "libraries"
    needs: tuple[str, ...] = ()

    def __init__(self, *names: str) -> None:
        self._names = names

    def run(self, context: Context) -> Finding:
        """See `Check`."""
        try:
            found = in_child(partial(load, self._names), LIMIT_S)
        except UserFacingError as error:
            return failed(
                f"loading {', '.join(self._names)}: {error}",
                f"install them afresh: {self._install('--reinstall ')}",
            )
        files = {library.name: library.file for library in found}
        errors = [library.error for library in found if library.error]
        if errors:
            return failed("; ".join(errors), self._install(), files=files)
        return passed(", ".join(library.file or library.name for library in found), files=files)

    def _install(self, how: str = "") -> str:
        packages = [PACKAGES[name] for name in self._names if name in PACKAGES]
        return f"sudo apt install {how}{' '.join(packages)}"
