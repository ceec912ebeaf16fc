"""Whether the native libraries are there, and which files they are."""

from functools import partial

from drivers.core.errors import UserFacingError
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed
from vo_service.tools.doctor.library_info import load_libraries
from vo_service.tools.doctor.subprocess_call import call_in_subprocess

LOAD_TIMEOUT_S = 10.0
DEBIAN_PACKAGES = {
    "libfreenect.so.0.5": "libfreenect0.5",
    "libOpenNI2.so.0": "libopenni2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


class LibrariesCheck:
    """The libraries of one kind of camera."""

    name = "libraries"
    needs: tuple[str, ...] = ()

    def __init__(self, *names: str) -> None:
        self._names = names

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        try:
            found = call_in_subprocess(partial(load_libraries, self._names), LOAD_TIMEOUT_S)
        except UserFacingError as error:
            return failed(
                f"loading {', '.join(self._names)}: {error}",
                f"install them afresh: {self._install_command('--reinstall ')}",
            )
        files = {library.name: library.file for library in found}
        errors = [library.error for library in found if library.error]
        if errors:
            return failed("; ".join(errors), self._install_command(), files=files)
        return passed(", ".join(library.file or library.name for library in found), files=files)

    def _install_command(self, apt_options: str = "") -> str:
        packages = [DEBIAN_PACKAGES[name] for name in self._names if name in DEBIAN_PACKAGES]
        return f"sudo apt install {apt_options}{' '.join(packages)}"
