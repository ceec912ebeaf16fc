"""Everything that a bug report needs, in one file: whole, or not there at all."""

import json
import logging
import shutil
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.errors import InputError, UserFacingError

SUFFIX = ".tar.gz"
LOG_FILE = "log.txt"
OWN_LOGS = ("drivers", "vo_service", "kinect-vo")


class Report:
    """A folder that becomes one packed file beside it; use through `report_to`."""

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
def report_to(file: Path) -> Iterator[Report]:
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
            with _log_to(Path(folder) / LOG_FILE):
                yield Report(file, Path(folder))
        except OSError as error:
            raise UserFacingError(
                f"{file}: {error.strerror}; nothing was left behind; see to the disk and try again"
            ) from error


@contextmanager
def _log_to(file: Path) -> Iterator[None]:
    """Write the log in detail to a file; what goes elsewhere stays as it is."""
    root = logging.getLogger()
    before = root.level
    levels = [(handler, handler.level) for handler in root.handlers]
    for handler, level in levels:
        handler.setLevel(max(level, before))
    detailed = logging.FileHandler(file)
    detailed.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    # The details of other packages would drown ours.
    detailed.addFilter(lambda record: record.levelno > logging.INFO or _is_ours(record.name))
    root.addHandler(detailed)
    root.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        root.setLevel(before)
        root.removeHandler(detailed)
        detailed.close()
        for handler, level in levels:
            handler.setLevel(level)


def _is_ours(logger: str) -> bool:
    return logger.partition(".")[0] in OWN_LOGS
