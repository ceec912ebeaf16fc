"""Folder of saved maps, with a limit of its size and atomic writes."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.files import (
    MEGABYTE,
    PARTIAL_SUFFIX,
    folder_size_bytes,
    partial_folder,
    remove_partial_folders,
)
from drivers.core.write_errors import writing
from vo_service.navigation.grid_files import (
    IMAGE_SUFFIX,
    SETTINGS_SUFFIX,
    write_grid_image,
    write_grid_settings,
)
from vo_service.types.occupancy_grid import OccupancyGrid

# Suffixes of a saved map's files: the mesh, the keyframes with their pose graph, and the grid.
MESH_SUFFIX = ".ply"
MAP_SUFFIX = ".keyframes"
SUFFIXES = (MESH_SUFFIX, MAP_SUFFIX, IMAGE_SUFFIX, SETTINGS_SUFFIX)


class MapStore:
    """Folder of saved maps, used only by the mapper.

    Partial files are in a locked folder, so that another service of the same user does not remove
    them.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def names(self) -> frozenset[str]:
        """Names of the maps.

        Raises:
            OSError: If the folder cannot be read.
        """
        return frozenset(file.stem for file in self._files())

    @property
    def loadable_names(self) -> frozenset[str]:
        """Names of the maps that can be loaded.

        Raises:
            OSError: If the folder cannot be read.
        """
        return frozenset(file.stem for file in self._files() if file.suffix == MAP_SUFFIX)

    def mesh_file(self, name: str) -> Path:
        """Path of a map's mesh."""
        return self.folder / f"{name}{MESH_SUFFIX}"

    def map_file(self, name: str) -> Path:
        """Path of a map's keyframes."""
        return self.folder / f"{name}{MAP_SUFFIX}"

    def write_grid(self, name: str, grid: OccupancyGrid, max_total_bytes: int) -> None:
        """Write a map's occupancy grid, as an image and its settings.

        Raises:
            UserFacingError: As `write`.
        """
        for suffix, write in (
            (IMAGE_SUFFIX, write_grid_image),
            (SETTINGS_SUFFIX, write_grid_settings),
        ):
            file = self.folder / f"{name}{suffix}"
            self.write(file, max_total_bytes, partial(write, grid=grid))

    def clean_up(self) -> None:
        """Remove partial files of an earlier mapper.

        Raises:
            OSError: If that fails.
        """
        if self.folder.is_dir():
            remove_partial_folders(self.folder.glob(f"*{PARTIAL_SUFFIX}"))

    def write(
        self, final: Path, max_total_bytes: int, write_content: Callable[[Path], None]
    ) -> Path:
        """Write a file of this folder atomically; the oldest maps are removed to make room.

        Args:
            final: Path of the file.
            max_total_bytes: Largest size of all maps.
            write_content: Writes the content to a given path.

        Returns:
            The path of the file.

        Raises:
            WriteError: The file cannot be written; nothing is left of it.
            UserFacingError: It is too large.
        """
        with writing(final):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.clean_up()  # a killed process may have left partial files
            with partial_folder(self.folder / final.name) as part:
                write_content(part / final.name)
                self._make_room(final, folder_size_bytes(part), max_total_bytes)
                (part / final.name).rename(final)
        return final

    def _make_room(self, final: Path, size: int, max_total_bytes: int) -> None:
        if size > max_total_bytes:
            raise UserFacingError(
                f"{final}: it needs {size // MEGABYTE} MB, more than map.total_mb allows for all "
                "maps; increase map.total_mb or map.voxel_m"
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
            file for file in self.folder.iterdir() if file.suffix in SUFFIXES and file.is_file()
        ]
