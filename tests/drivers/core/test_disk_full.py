"""How much is free on a disk, also where that cannot be known."""

import shutil
from pathlib import Path

from drivers.core.files import free_disk_bytes


def test_free_disk_space_is_reported(tmp_path: Path) -> None:
    assert 0 < free_disk_bytes(tmp_path) < shutil.disk_usage(tmp_path).total


def test_a_file_system_without_a_size_is_not_full() -> None:
    assert shutil.disk_usage("/proc").free == 0
    assert free_disk_bytes(Path("/proc")) > 10**15
