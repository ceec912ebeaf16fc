"""The text lists of a TUM folder: which image was taken when."""

from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePath

from drivers.core.errors import InputError

# Stamps are kept as written: 17 digits of seconds do not fit a float, and a difference of two
# stamps is then exact. The precision holds the sum of any two floats that have been printed.
EXACT_CONTEXT = Context(prec=100)
_MAX_STAMP_S = Decimal(10**11)


@dataclass(frozen=True)
class ListedImage:
    """One image of a list: its stamp in seconds, its file, and where the list says so."""

    stamp: Decimal
    file: Path
    location: str  # "LIST:LINE"

    @property
    def stamp_s(self) -> float:
        """The stamp as a float."""
        return float(self.stamp)


@dataclass(frozen=True)
class FramePair:
    """Color and depth that belong together."""

    color: ListedImage
    depth: ListedImage

    @property
    def skew_s(self) -> float:
        """Instant of depth minus instant of color."""
        return float(EXACT_CONTEXT.subtract(self.depth.stamp, self.color.stamp))


def read_image_list(path: Path) -> list[ListedImage]:
    """Read ``rgb.txt`` or ``depth.txt``: lines of ``stamp file``, ``#`` comments.

    Files are below the list's folder. Raises InputError naming file and line if the list cannot be
    read, is empty, does not parse, if a path leads out of the folder by what it says (absolute, or
    with ``..``; links are followed), or if stamps repeat or go backwards.
    """
    images = [_parse_image(words, path, n) for n, words in _read_image_rows(path, "stamp file")]
    _check_increasing(images)
    return images


def read_associations(path: Path) -> list[FramePair]:
    """Read ``associations.txt``: lines of ``stamp color_file stamp depth_file``.

    Raises InputError as `read_image_list`, for either column of stamps.
    """
    rows = _read_image_rows(path, "stamp color_file stamp depth_file")
    pairs = [FramePair(_parse_image(w[:2], path, n), _parse_image(w[2:], path, n)) for n, w in rows]
    _check_increasing([pair.color for pair in pairs])
    _check_increasing([pair.depth for pair in pairs])
    return pairs


def read_rows(path: Path, columns: str) -> list[tuple[int, list[str]]]:
    """The line number and the words of every line that is neither blank nor a comment.

    Raises InputError naming the file, and the line where the number of words is not that of `form`.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file; expected lines of: {columns}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != len(columns.split()):
            raise InputError(
                f"{path}:{number}: {len(words)} columns where {len(columns.split())} are expected: "
                f"{columns}"
            )
        rows.append((number, words))
    return rows


def _read_image_rows(path: Path, columns: str) -> list[tuple[int, list[str]]]:
    rows = read_rows(path, columns)
    if not rows:
        raise InputError(f"{path}: names no image; expected lines of: {columns}")
    return rows


def _parse_image(words: list[str], path: Path, number: int) -> ListedImage:
    where = f"{path}:{number}"
    try:
        stamp = Decimal(words[0])
    except InvalidOperation as error:
        raise InputError(
            f'{where}: "{words[0]}" is not a stamp; the column must be seconds, as 1305031102.1753'
        ) from error
    if not stamp.is_finite() or abs(stamp) > _MAX_STAMP_S:
        raise InputError(f"{where}: stamp {words[0]} is not in seconds; rewrite the list")
    return ListedImage(stamp, path.parent / _resolve_inside(words[1], where), where)


def _resolve_inside(text: str, location: str) -> PurePath:
    """The path of an image, from the list's folder. Raises InputError if it leads out of that.

    What the list says counts, not what is on the disk: a folder may be a link to another disk.
    """
    path = PurePath(text)
    if path.is_absolute() or ".." in path.parts:
        raise InputError(
            f'{location}: "{text}" leads out of the recording\'s folder; put the image (or a link to '
            "it) into that folder, and write its path from there"
        )
    return path


def _check_increasing(images: list[ListedImage]) -> None:
    for before, image in pairwise(images):
        if image.stamp_s <= before.stamp_s:
            fault = "repeats" if image.stamp_s == before.stamp_s else "goes back"
            raise InputError(
                f"{image.location}: stamp {image.stamp} {fault} (the one before is {before.stamp}); "
                "sort the list by its stamps and remove repeats"
            )
