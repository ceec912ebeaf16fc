"""Error messages of rejected maps."""

from pathlib import Path

import pytest

from drivers.core import InputError
from vo_service.slam.map_file import read_map


def load_error(path: Path) -> str:
    """The error message of a rejected map."""
    with pytest.raises(InputError) as refused:
        read_map(path)
    line = str(refused.value)
    assert line.startswith(f"{path}: ")
    assert line.endswith("choose another map or start a new one")
    assert "\n" not in line
    return line
