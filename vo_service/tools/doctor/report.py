"""Bug report in one packed file, which is written completely or not at all."""

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
    """Folder that is packed into one file; create it with `open_bug_report`."""

    def __init__(self, file: Path, folder: Path) -> None:
        self._file = file
        self.folder = folder  # files to pack go here

    def add_text(self, name: str, text: str) -> None:
        """Add a text file.

        Raises:
            OSError: If that fails.
        """
        (self.folder / name).write_text(text)

    def add_json(self, name: str, content: object) -> None:
        """Add a JSON file.

        Raises:
            OSError: If that fails.
        """
        self.add_text(name, json.dumps(content, indent=2, ensure_ascii=False) + "\n")

    def add_copy(self, file: Path) -> None:
        """Add a copy of a file under its own name.

        Raises:
            OSError: If that fails.
        """
        shutil.copyfile(file, self.folder / file.name)

    def pack(self) -> int:
        """Write the file and return its size, bytes. On OSError no file is left."""
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
    """Open a report that holds a detailed log of the block.

    Raises:
        InputError: The file name is invalid, the file exists, or its folder is not writable.
        UserFacingError: The disk fails in the block.
    """
    if not file.name.endswith(SUFFIX) or file.name == SUFFIX:
        raise InputError(f"{file}: the name of a report must end in {SUFFIX}")
    if file.exists():
        raise InputError(f"{file}: already exists; name a new file, or remove it first")
    try:
        temporary = tempfile.TemporaryDirectory(prefix=".kinect-vo-report-", dir=file.parent)
    except OSError as error:
        raise InputError(
            f"{file}: cannot be written: {error.strerror}; name a writable folder"
        ) from error
    with temporary as folder:
        try:
            with log_details_to(Path(folder) / LOG_FILE):
                yield BugReport(file, Path(folder))
        except OSError as error:
            raise UserFacingError(
                f"{file}: {error.strerror}; no file was written; check the disk and try again"
            ) from error
