"""The folder of incidents: names, its total size, and folders that appear only when whole."""

import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.core.errors import UserFacingError
from drivers.core.files import PARTIAL_SUFFIX, describe_write_error, folder_size_bytes, lock_folder

_NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ-[a-z0-9-]+")
_MAX_REASON_LENGTH = 40


def incident_name(reason: str, unix_s: float) -> str:
    """What an incident's folder is called, such as 2026-11-21T16-30-05Z-lost."""
    words = re.sub("[^a-z0-9]+", "-", reason.lower()).strip("-")[:_MAX_REASON_LENGTH] or "saved"
    return f"{time.strftime('%Y-%m-%dT%H-%M-%SZ', time.gmtime(unix_s))}-{words}"


class IncidentStore:
    """Only folders with an incident's name are ever deleted: the user may have named any folder.

    What is being written is locked, so that another service that shares the folder, or one that
    was started again while its forerunner's recorder still writes, leaves it alone.
    """

    def __init__(self, folder: Path, max_total_bytes: int) -> None:
        self.folder = folder
        self.max_total_bytes = max_total_bytes

    def clean_up(self) -> None:
        """Remove what an earlier recorder could not finish, and what is too much.

        Raises OSError if the folder cannot be used.
        """
        for part in self._incidents(PARTIAL_SUFFIX):
            with suppress(OSError), lock_folder(part):
                shutil.rmtree(part, ignore_errors=True)
        self._make_room(0)

    def _make_room(self, expected_bytes: int) -> None:
        """Delete the oldest incidents until so many bytes more fit into the total."""
        incidents = sorted(self._incidents(""))
        sizes = {incident: folder_size_bytes(incident) for incident in incidents}
        excess = sum(sizes.values()) + expected_bytes - self.max_total_bytes
        for oldest in incidents:
            if excess <= 0:
                return
            shutil.rmtree(oldest, ignore_errors=True)
            excess -= sizes[oldest] - folder_size_bytes(oldest)

    def write(self, name: str, write_content: Callable[[Path], None]) -> Path:
        """Let `fill` write into an empty folder; it gets its name when it is whole.

        Older incidents make room for it. Raises UserFacingError, leaving nothing, if the disk
        refuses or `fill` does.
        """
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            final = self._free_name(name)
            part = final.with_name(final.name + PARTIAL_SUFFIX)
            part.mkdir(mode=0o700)
            try:
                with lock_folder(part):
                    write_content(part)
                    self._make_room(folder_size_bytes(part))
                    part.rename(final)
            except BaseException:
                shutil.rmtree(part, ignore_errors=True)
                raise
        except (OSError, UserFacingError) as error:
            raise UserFacingError(f"{self.folder}: {describe_write_error(error)}") from error
        return final

    def _free_name(self, name: str) -> Path:
        """`name`, or with a number where an incident of the same second has it already."""
        final, number = self.folder / name, 2
        while final.exists() or final.with_name(final.name + PARTIAL_SUFFIX).exists():
            final, number = self.folder / f"{name}-{number}", number + 1
        return final

    def _incidents(self, suffix: str) -> list[Path]:
        if not self.folder.is_dir():
            return []
        return [
            path
            for path in self.folder.iterdir()
            if path.name.endswith(suffix)
            and _NAME.fullmatch(path.name.removesuffix(suffix))
            and path.is_dir()
            and not path.is_symlink()
        ]
