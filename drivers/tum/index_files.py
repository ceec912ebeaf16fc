"""The text lists of a TUM folder, with stamps and image files."""

from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePath

from drivers.core.errors import InputError

# Stamps are kept as decimals: 17 digits of seconds do not fit a float, and differences are exact.
# The precision holds the sum of any two printed floats.
EXACT_CONTEXT = Context(prec=100)
_MAX_STAMP_S = Decimal(10**11)


@dataclass(frozen=True)
class ListedImage:
    """One image of a list: its stamp in seconds, its file, and its line in the list."""

    stamp: Decimal
    file: Path
    location: str  # "LIST:LINE"

    @property
    def stamp_s(self) -> float:
        """The stamp as a float."""
        return float(self.stamp)


@dataclass(frozen=True)
class FramePair:
    """The color and the depth image of one frame."""

    color: ListedImage
    depth: ListedImage

    @property
    def skew_s(self) -> float:
        """Stamp of depth minus stamp of color."""
        return float(EXACT_CONTEXT.subtract(self.depth.stamp, self.color.stamp))


def read_image_list(path: Path) -> list[ListedImage]:
    """Read ``rgb.txt`` or ``depth.txt``: lines of ``stamp file``, ``#`` comments.

    Raises:
        InputError: The list cannot be read, is empty or does not parse, its stamps do not rise, or
            a path is absolute or contains ``..`` (links are followed). The message names file and
            line.
    """
    images = [_parse_image(words, path, n) for n, words in _read_image_rows(path, "stamp file")]
    _check_increasing(images)
    return images


def read_associations(path: Path) -> list[FramePair]:
    """Read ``associations.txt``: lines of ``stamp color_file stamp depth_file``.

    Raises:
        InputError: As for `read_image_list`, for both columns of stamps.
    """
    rows = _read_image_rows(path, "stamp color_file stamp depth_file")
    pairs = [FramePair(_parse_image(w[:2], path, n), _parse_image(w[2:], path, n)) for n, w in rows]
    _check_increasing([pair.color for pair in pairs])
    _check_increasing([pair.depth for pair in pairs])
    return pairs


def read_rows(path: Path, columns: str) -> list[tuple[int, list[str]]]:
    """Read a list's lines other than blank lines and comments.

    Args:
        path: The list.
        columns: Names of the columns, separated by spaces.

    Returns:
        The number (from 1) and the columns of each line.

    Raises:
        InputError: The list cannot be read, or a line has a wrong number of columns.
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
    location = f"{path}:{number}"
    try:
        stamp = Decimal(words[0])
    except InvalidOperation as error:
        raise InputError(
            f'{location}: "{words[0]}" is not a stamp; the column must be seconds, such as '
            "1305031102.1753"
        ) from error
    if not stamp.is_finite() or abs(stamp) > _MAX_STAMP_S:
        raise InputError(f"{location}: stamp {words[0]} is not in seconds; rewrite the list")
    return ListedImage(stamp, path.parent / _resolve_inside(words[1], location), location)


def _resolve_inside(text: str, location: str) -> PurePath:
    """Return an image's path relative to the list's folder. Raises InputError if it leads outside.

    Only the text is checked: on disk a folder may be a link to another disk.
    """
    path = PurePath(text)
    if path.is_absolute() or ".." in path.parts:
        raise InputError(
            f'{location}: "{text}" leads out of the recording\'s folder; put the image (or a link '
            "to it) into that folder, and give its path relative to it"
        )
    return path


def _check_increasing(images: list[ListedImage]) -> None:
    for before, image in pairwise(images):
        if image.stamp_s <= before.stamp_s:
            fault = "repeats" if image.stamp_s == before.stamp_s else "goes back"
            raise InputError(
                f"{image.location}: stamp {image.stamp} {fault} (the previous one is "
                f"{before.stamp}); sort the list by its stamps and remove duplicates"
            )
