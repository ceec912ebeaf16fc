"""Everything that a bug report needs, in one file: whole, or not there at all."""

import json
import shutil
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError
from vo_service.tools.doctor.logs import log_details_to

SUFFIX = ".tar.gz"
LOG_FILE = "log.txt"


class BugReport:
    """A folder that becomes one packed file beside it; use through `open_bug_report`."""

    def __init__(self, file: Path, folder: Path) -> None:
        self._file = file
        self.folder = folder  # put whatever belongs into the report here

    def add_text(self, name: str, text: str) -> None:
        """One more file. Raises OSError."""
        (self.folder / name).write_text(text)

    def add_json(self, name: str, content: object) -> None:
        """One more file. Raises OSError."""
        self.add_text(name, json.dumps(content, indent=2, ensure_ascii=False) + "\n")

    def add_copy(self, file: Path) -> None:
        """A file of the user's, under its own name. Raises OSError."""
        shutil.copyfile(file, self.folder / file.name)

    def pack(self) -> int:
        """Write the file; its size in bytes. Raises OSError, and leaves nothing then."""
        part = self._file.with_name(f".{self._file.name}.part")
        try:
            with tarfile.open(part, "w:gz", compresslevel=1) as archive:
                archive.add(self.folder, arcname=self._file.name.removesuffix(SUFFIX))
            size = part.stat().st_size
            part.replace(self._file)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        return size


@contextmanager
def open_bug_report(file: Path) -> Iterator[BugReport]:
    """A report whose log holds all that happens in the block, in detail.

    Raises InputError if there can be no such file, UserFacingError if the disk refuses later.
    """
    if not file.name.endswith(SUFFIX) or file.name == SUFFIX:
        raise InputError(f"{file}: a report is a packed file; let its name end in {SUFFIX}")
    if file.exists():
        raise InputError(f"{file}: is there already; name a new file, or remove it first")
    try:
        temporary = tempfile.TemporaryDirectory(prefix=".kinect-vo-report-", dir=file.parent)
    except OSError as error:
        raise InputError(f"{file}: cannot be written there: {error.strerror}") from error
    with temporary as folder:
        try:
            with log_details_to(Path(folder) / LOG_FILE):
                yield BugReport(file, Path(folder))
        except OSError as error:
            raise UserFacingError(
                f"{file}: {error.strerror}; nothing was left behind; see to the disk and try again"
            ) from error
