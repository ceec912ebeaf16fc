"""The folder of maps: their total size, and files that appear only when whole."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.core.errors import UserFacingError
from drivers.core.files import PARTIAL_SUFFIX, describe_write_error, folder_size_bytes, lock_folder
from vo_service.config_tables import MEGABYTE

MESH_SUFFIX = ".ply"
MAP_SUFFIX = ".places"


class MapStore:
    """Maps, and nothing else: the folder is the mapper's own.

    What is being written lies in a folder that is locked, so that another service of the same user
    leaves it alone.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def names(self) -> frozenset[str]:
        """Of the maps that are there. Raises OSError if the folder cannot be read."""
        return frozenset(file.stem for file in self._files())

    @property
    def loadable_names(self) -> frozenset[str]:
        """Of the maps whose places can be loaded. Raises OSError if it cannot be read."""
        return frozenset(file.stem for file in self._files() if file.suffix == MAP_SUFFIX)

    def mesh_file(self, name: str) -> Path:
        """Where a map's surface is, or will be."""
        return self.folder / f"{name}{MESH_SUFFIX}"

    def map_file(self, name: str) -> Path:
        """Where a map's places are, or will be."""
        return self.folder / f"{name}{MAP_SUFFIX}"

    def clean_up(self) -> None:
        """Remove what an earlier mapper could not finish. Raises OSError."""
        if self.folder.is_dir():
            for part in self.folder.glob(f"*{PARTIAL_SUFFIX}"):
                with suppress(OSError), lock_folder(part):
                    shutil.rmtree(part, ignore_errors=True)

    def write(
        self, final: Path, max_total_bytes: int, write_content: Callable[[Path], None]
    ) -> Path:
        """Let `fill` write a file of this folder; it gets its name when it is whole. Its path.

        The oldest maps make room for it, so that all together have at most `total_bytes`. Raises
        UserFacingError, leaving nothing, if the disk refuses or `fill` does.
        """
        part = self.folder / f"{final.name}{PARTIAL_SUFFIX}"
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.clean_up()  # else what a process that was killed left is in the way
            part.mkdir(mode=0o700)
            try:
                with lock_folder(part):
                    write_content(part / final.name)
                    self._make_room(final, folder_size_bytes(part), max_total_bytes)
                    (part / final.name).rename(final)
            finally:
                shutil.rmtree(part, ignore_errors=True)
        except (OSError, UserFacingError) as error:
            raise UserFacingError(f"{final}: {describe_write_error(error)}") from error
        return final

    def _make_room(self, final: Path, size: int, max_total_bytes: int) -> None:
        if size > max_total_bytes:
            raise UserFacingError(
                f"it has {size // MEGABYTE} MB, more than map.total_mb allows for all maps; raise "
                "that, or map.voxel_m"
            )
        others = [file for file in self._files() if file != final]
        ages_s = {file: file.stat().st_mtime for file in others if file.stem != final.stem}
        excess = size + sum(file.stat().st_size for file in others) - max_total_bytes
        for oldest in sorted(ages_s, key=lambda file: ages_s[file]):
            if excess <= 0:
                return
            excess -= oldest.stat().st_size
            oldest.unlink()

    def _files(self) -> list[Path]:
        if not self.folder.is_dir():
            return []
        return [
            file
            for file in self.folder.iterdir()
            if file.suffix in (MESH_SUFFIX, MAP_SUFFIX) and file.is_file()
        ]
