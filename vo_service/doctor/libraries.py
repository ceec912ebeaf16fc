"""Whether the native libraries are there, and which files they are."""

from functools import partial

from drivers.errors import UserFacingError
from vo_service.doctor.child import in_child
from vo_service.doctor.context import Context
from vo_service.doctor.finding import Finding, failed, passed
from vo_service.doctor.loaded import load

LIMIT_S = 10.0
PACKAGES = {
    "libfreenect.so.0.5": "libfreenect0.5",
    "libOpenNI2.so.0": "libopenni2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


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
