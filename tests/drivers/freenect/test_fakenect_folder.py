from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import InputError
from drivers.freenect.sources import check_dump_folder
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.fixtures import pattern_frame


@pytest.fixture
def dump(tmp_path: Path) -> Path:
    """A dump to break."""
    write_fakenect_dump(tmp_path / "dump", [pattern_frame(0), pattern_frame(1)])
    return tmp_path / "dump"


def first(folder: Path, kind: str) -> Path:
    return sorted(folder.glob(f"{kind}-*"))[0]


def test_a_valid_dump_passes(dump: Path) -> None:
    check_dump_folder(dump)


def no_line(folder: Path) -> None:
    file = first(folder, "d")
    file.write_bytes(file.read_bytes().replace(b"\n", b" ", 1))


@pytest.mark.parametrize(
    ("breaking", "words"),
    [
        (lambda folder: (folder / "INDEX.txt").unlink(), "INDEX.txt: cannot be read"),
        (lambda folder: (folder / "INDEX.txt").write_text("d-1.5-2.pgm\n"), "INDEX.txt names it"),
        (lambda folder: (folder / "INDEX.txt").write_text("rgb/1.png\n"), "INDEX.txt:1: 'rgb/1"),
        (lambda folder: (folder / "INDEX.txt").write_text(""), "names no depth image"),
        (lambda folder: (folder / "INDEX.txt").write_bytes(b"\xff"), "is not UTF-8"),
        (lambda folder: first(folder, "r").write_bytes(b"P6\n12"), "not one line of text"),
        (no_line, "not one line of text"),
        (lambda folder: first(folder, "a").unlink(), "cannot be read"),
    ],
)
def test_a_dump_that_would_crash_fakenect_is_rejected_before(
    breaking: Callable[[Path], object], words: str, dump: Path
) -> None:
    breaking(dump)
    with pytest.raises(InputError, match=words):
        check_dump_folder(dump)


def test_a_dump_without_color_is_rejected(dump: Path) -> None:
    index = dump / "INDEX.txt"
    lines = index.read_text().splitlines()
    index.write_text("\n".join(line for line in lines if not line.startswith("r")))
    with pytest.raises(InputError, match="names no color image"):
        check_dump_folder(dump)
