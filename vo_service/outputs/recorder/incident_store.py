"""The folder of incidents: names, disk quota and atomic creation of incident folders."""

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
    """Return the name of an incident's folder, such as 2026-11-21T16-30-05Z-lost."""
    suffix = re.sub("[^a-z0-9]+", "-", reason.lower()).strip("-")[:_MAX_REASON_LENGTH] or "saved"
    return f"{time.strftime('%Y-%m-%dT%H-%M-%SZ', time.gmtime(unix_s))}-{suffix}"


class IncidentStore:
    """Folder of incidents with a disk quota.

    Only folders with an incident's name are deleted, as the user may choose any folder. An incident
    is locked while it is written, so that another service, or a restarted one, does not delete it.
    """

    def __init__(self, folder: Path, max_total_bytes: int) -> None:
        self.folder = folder
        self.max_total_bytes = max_total_bytes

    def clean_up(self) -> None:
        """Remove partial incidents of earlier recorders, and old ones over the quota.

        Raises:
            OSError: The folder is not usable.
        """
        for part in self._incidents(PARTIAL_SUFFIX):
            with suppress(OSError), lock_folder(part):
                shutil.rmtree(part, ignore_errors=True)
        self._make_room(0)

    def _make_room(self, expected_bytes: int) -> None:
        """Delete the oldest incidents until this many more bytes fit into the quota."""
        incidents = sorted(self._incidents(""))
        sizes = {incident: folder_size_bytes(incident) for incident in incidents}
        excess = sum(sizes.values()) + expected_bytes - self.max_total_bytes
        for oldest in incidents:
            if excess <= 0:
                return
            shutil.rmtree(oldest, ignore_errors=True)
            excess -= sizes[oldest] - folder_size_bytes(oldest)

    def write(self, name: str, write_content: Callable[[Path], None]) -> Path:
        """Write an incident into a partial folder, then rename it.

        The oldest incidents are deleted to make room.

        Args:
            name: The incident's name; a number is added if it exists.
            write_content: Fills the empty folder that it is given.

        Returns:
            The incident's folder.

        Raises:
            UserFacingError: The disk or `write_content` failed; nothing is left.
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
        """Return `name`, with a number if an incident of the same second exists."""
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
