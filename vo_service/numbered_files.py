"""Files that are kept when a new one of the same name is begun."""

import re
from pathlib import Path


def rotate_file(path: Path, max_files: int) -> None:
    """Make room for a new file: name the one that is there FILE-NNNN, delete the oldest.

    The higher the number, the newer. Raises OSError.
    """
    numbers = sorted(_rotation_numbers(path))
    if path.is_file():
        numbers.append(numbers[-1] + 1 if numbers else 1)
        path.rename(_rotated_path(path, numbers[-1]))
    for number in numbers[: max(0, len(numbers) - max_files + 1)]:
        _rotated_path(path, number).unlink()


def _rotation_numbers(path: Path) -> list[int]:
    form = re.compile(re.escape(path.stem) + r"-(\d{4,})" + re.escape(path.suffix))
    found = (form.fullmatch(each.name) for each in path.parent.iterdir() if each.is_file())
    return [int(each[1]) for each in found if each]


def _rotated_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number:04d}{path.suffix}")
