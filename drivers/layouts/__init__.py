"""Folders in the layouts of other benchmarks than TUM's."""

from drivers.layouts.folder import find_layout, open_folder

__all__ = ["find_layout", "open_folder"]
