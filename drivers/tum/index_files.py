"""The lists of a TUM folder: its images with their stamps."""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePath

from drivers.core import InputError
from drivers.core.input_files import read_input, read_input_text
from drivers.recording.image_decoding import (
    BgrImage,
    DepthImage,
    UnreadableFrameError,
    decode_color,
    decode_depth,
    stored_color,
    stored_depth,
)
from drivers.recording.recorded_frames import FramePair, RecordedImage

_MAX_STAMP_S = Decimal(10**11)


class ListedImage(RecordedImage):
    """One image file of a list; its location is LIST:LINE."""

    def read_color(self) -> BgrImage:
        """Read the file, see `decode_color`."""
        return decode_color(self._read_bytes(), self.name)

    def read_depth(self) -> DepthImage:
        """Read the file, see `decode_depth`."""
        return decode_depth(self._read_bytes(), self.name)

    def read_stored_color(self) -> bytes | BgrImage:
        """Read the bytes of a PNG or JPEG, and decode others."""
        return stored_color(self._read_bytes(), self.name)

    def read_stored_depth(self) -> bytes | DepthImage:
        """Read the bytes of a PNG, and decode others."""
        return stored_depth(self._read_bytes(), self.name)

    def _read_bytes(self) -> bytes:
        try:
            return read_input(self.file)
        except OSError as error:
            raise UnreadableFrameError(f"{self.name}: cannot be read: {error.strerror}") from error


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

    Depth may come first, if the folders of the files tell it.

    Raises:
        InputError: As for `read_image_list`, for both columns of stamps.
    """
    rows = _read_image_rows(path, "stamp color_file stamp depth_file")
    if all("depth" in words[1] and "depth" not in words[3] for _, words in rows):
        rows = [(number, [*words[2:], *words[:2]]) for number, words in rows]
    pairs = [FramePair(_parse_image(w[:2], path, n), _parse_image(w[2:], path, n)) for n, w in rows]
    _check_increasing([pair.color for pair in pairs])
    _check_increasing([pair.depth for pair in pairs])
    return pairs


def read_rows(path: Path, columns: str) -> list[tuple[int, list[str]]]:
    """Read a list's lines other than blank lines and comments.

    Args:
        columns: Names of the columns, separated by spaces.

    Returns:
        The number (from 1) and the columns of each line.

    Raises:
        InputError: The list cannot be read, or a line has a wrong number of columns.
    """
    lines = read_input_text(path, f"give a text file with lines of: {columns}").splitlines()
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


def _check_increasing(images: Sequence[RecordedImage]) -> None:
    for before, image in pairwise(images):
        if image.stamp_s <= before.stamp_s:
            fault = "repeats" if image.stamp_s == before.stamp_s else "goes back"
            raise InputError(
                f"{image.location}: stamp {image.stamp} {fault} (the previous one is "
                f"{before.stamp}); sort the list by its stamps and remove duplicates"
            )
