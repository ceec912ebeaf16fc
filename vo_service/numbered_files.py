"""Files that are kept when a new one of the same name is begun."""

import re
from pathlib import Path


def put_aside(path: Path, files_kept: int) -> None:
    """Make room for a new file: name the one that is there FILE-NNNN, delete the oldest.

    The higher the number, the newer. Raises OSError.
    """
    numbers = sorted(_numbers(path))
    if path.is_file():
        numbers.append(numbers[-1] + 1 if numbers else 1)
        path.rename(_numbered(path, numbers[-1]))
    for number in numbers[: max(0, len(numbers) - files_kept + 1)]:
        _numbered(path, number).unlink()


def _numbers(path: Path) -> list[int]:
    form = re.compile(re.escape(path.stem) + r"-(\d{4,})" + re.escape(path.suffix))
    found = (form.fullmatch(each.name) for each in path.parent.iterdir() if each.is_file())
    return [int(each[1]) for each in found if each]


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number:04d}{path.suffix}")
