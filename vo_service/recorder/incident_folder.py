"""The folder of incidents: names, its total size, and folders that appear only when whole."""

import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.errors import UserFacingError
from drivers.full_disk import PART, locked, size_of, why_not

_NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ-[a-z0-9-]+")
_LONGEST_REASON = 40


def incident_name(reason: str, unix_s: float) -> str:
    """What an incident's folder is called, such as 2026-11-21T16-30-05Z-lost."""
    words = re.sub("[^a-z0-9]+", "-", reason.lower()).strip("-")[:_LONGEST_REASON] or "saved"
    return f"{time.strftime('%Y-%m-%dT%H-%M-%SZ', time.gmtime(unix_s))}-{words}"


class IncidentFolder:
    """Only folders with an incident's name are ever deleted: the user may have named any folder.

    What is being written is locked, so that another service that shares the folder, or one that
    was started again while its forerunner's recorder still writes, leaves it alone.
    """

    def __init__(self, folder: Path, total_bytes: int) -> None:
        self.folder = folder
        self.total_bytes = total_bytes

    def clean_up(self) -> None:
        """Remove what an earlier recorder could not finish, and what is too much.

        Raises OSError if the folder cannot be used.
        """
        for part in self._incidents(PART):
            with suppress(OSError), locked(part):
                shutil.rmtree(part, ignore_errors=True)
        self._make_room(0)

    def _make_room(self, expected_bytes: int) -> None:
        """Delete the oldest incidents until so many bytes more fit into the total."""
        incidents = sorted(self._incidents(""))
        sizes = {incident: size_of(incident) for incident in incidents}
        excess = sum(sizes.values()) + expected_bytes - self.total_bytes
        for oldest in incidents:
            if excess <= 0:
                return
            shutil.rmtree(oldest, ignore_errors=True)
            excess -= sizes[oldest] - size_of(oldest)

    def write(self, name: str, fill: Callable[[Path], None]) -> Path:
        """Let `fill` write into an empty folder; it gets its name when it is whole.

        Older incidents make room for it. Raises UserFacingError, leaving nothing, if the disk
        refuses or `fill` does.
        """
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            final = self._free_name(name)
            part = final.with_name(final.name + PART)
            part.mkdir(mode=0o700)
            try:
                with locked(part):
                    fill(part)
                    self._make_room(size_of(part))
                    part.rename(final)
            except BaseException:
                shutil.rmtree(part, ignore_errors=True)
                raise
        except (OSError, UserFacingError) as error:
            raise UserFacingError(f"{self.folder}: {why_not(error)}") from error
        return final

    def _free_name(self, name: str) -> Path:
        """`name`, or with a number where an incident of the same second has it already."""
        final, number = self.folder / name, 2
        while final.exists() or final.with_name(final.name + PART).exists():
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
