"""Check that the native libraries can be loaded, and from which files."""

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
    """Check the libraries of one kind of camera."""

    name = "libraries"
    needs: tuple[str, ...] = ()

    def __init__(self, *names: str) -> None:
        self._names = names

    def run(self, context: CheckContext) -> Finding:
        try:
            libraries = call_in_subprocess(partial(load_libraries, self._names), LOAD_TIMEOUT_S)
        except UserFacingError as error:
            return failed(
                f"loading {', '.join(self._names)}: {error}",
                f"reinstall them: {self._install_command('--reinstall ')}",
            )
        files = {library.name: library.file for library in libraries}
        errors = [library.error for library in libraries if library.error]
        if errors:
            return failed("; ".join(errors), self._install_command(), files=files)
        return passed(", ".join(library.file or library.name for library in libraries), files=files)

    def _install_command(self, apt_options: str = "") -> str:
        packages = [DEBIAN_PACKAGES[name] for name in self._names if name in DEBIAN_PACKAGES]
        return f"sudo apt install {apt_options}{' '.join(packages)}"
