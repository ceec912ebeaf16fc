"""A folder in the format of the TUM RGB-D benchmark: its lists of images, and its opening."""

import math
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path, PurePath

import numpy as np

from drivers.calibration import CAMERA_FILE_NAME, find_calibration
from drivers.camera import MAX_PAIR_SKEW_US
from drivers.core import InputError
from drivers.core.files import AppendOnlyFile
from drivers.core.geometry import (
    Vector,
    accelerometer_from_gravity,
    gravity_from_accelerometer,
)
from drivers.core.input_files import read_input, read_input_text
from drivers.recording import (
    AccelerometerSeries,
    BgrImage,
    DepthImage,
    FramePair,
    RecordedFrames,
    RecordedImage,
    Recording,
    UnreadableFrameError,
    decode_color,
    decode_depth,
    pair_images,
    stored_color,
    stored_depth,
)
from drivers.recording.small_depth import check_first_frame
from drivers.tum.ground_truth import read_ground_truth

_MAX_STAMP_S = Decimal(10**11)
ACCELEROMETER_FILE = "accelerometer.txt"
COLUMNS = "timestamp ax ay az"


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
        path: The list.
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


def read_accelerometer(folder: Path) -> AccelerometerSeries:
    """Read a folder's readings of the accelerometer; empty if there is no such file.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    path = folder / ACCELEROMETER_FILE
    rows = read_rows(path, COLUMNS) if path.exists() else []
    readings = [_parse_reading(words, f"{path}:{number}") for number, words in rows]
    table = np.array([(s, *g) for s, g in readings]).reshape(-1, 4)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return AccelerometerSeries(table[:, 0], -table[:, 1:])


class AccelerometerWriter:
    """Writes the file, which is created with the first reading."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ACCELEROMETER_FILE
        self._files: list[AppendOnlyFile] = []

    def add(self, stamp: str, gravity_m_s2: Vector | None) -> None:
        """Add a line; `read_accelerometer` gives back exactly the same.

        Raises:
            OSError: If that fails.
        """
        if gravity_m_s2 is None:
            return
        if not self._files:
            self._files.append(AppendOnlyFile(self._path, COLUMNS))
        values = accelerometer_from_gravity(gravity_m_s2)
        self._files[0].append(" ".join([stamp, *(repr(float(value)) for value in values)]))

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        while self._files:
            self._files.pop().close()


def _parse_reading(words: list[str], location: str) -> tuple[float, Vector]:
    try:
        stamp_s, x, y, z = map(float, words)
    except ValueError as error:
        raise InputError(
            f"{location}: {' '.join(words)!r} is not {COLUMNS}, all numbers"
        ) from error
    if not all(map(math.isfinite, (stamp_s, x, y, z))):
        raise InputError(f"{location}: a number is not finite; remove the line")
    return stamp_s, gravity_from_accelerometer((x, y, z))


def open_tum_folder(folder: Path, camera_file: Path | None) -> Recording:
    """Read a folder's lists, camera, ground truth and gravity, and load its first frame.

    Raises:
        InputError: The folder cannot be used.
    """
    _check_folder(folder)
    frames = read_frame_pairs(folder)
    camera = find_calibration(folder, camera_file)
    truth, note = read_ground_truth(folder, frames.stamps_s)
    file = camera_file or folder / CAMERA_FILE_NAME
    source = f"camera file {file}" if file.exists() else "the TUM benchmark's, by the folder's name"
    recording = Recording(
        folder,
        frames,
        camera,
        truth,
        read_accelerometer(folder),
        summary=note,
        intrinsics_source=source,
        depth_unit_source=source,
    )
    return check_frames(recording)


def check_frames(recording: Recording) -> Recording:
    """Load the first frame, see `check_first_frame`, and check that most other files exist.

    Raises:
        InputError: They do not, or the first frame does not fit the camera.
    """
    pairs = recording.frames.pairs
    _check_files(pairs)
    try:
        return check_first_frame(recording)
    except UnreadableFrameError as error:
        raise InputError(f"{error} (the first frame, {pairs[0].color.location})") from error


def _check_folder(folder: Path) -> None:
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; check the path")
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is not a folder, nor a .mcap, .bag or .db3 file; unpack an archive and "
            "name its folder"
        )
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    if empty:
        raise InputError(f"{folder}: the folder is empty; name one with rgb.txt and depth.txt")


def read_frame_pairs(folder: Path) -> RecordedFrames:
    """Read the frames in a folder's lists, without its images and its camera.

    Raises:
        InputError: A list is missing or does not parse, or no two images can be paired.
    """
    associations = folder / "associations.txt"
    if associations.exists():
        return RecordedFrames(read_associations(associations))
    for name in ("rgb.txt", "depth.txt"):
        if not (folder / name).exists():
            raise InputError(
                f"{folder / name}: no such file; a TUM folder holds rgb.txt and depth.txt, "
                "or associations.txt"
            )
    color, depth = read_image_list(folder / "rgb.txt"), read_image_list(folder / "depth.txt")
    frames = pair_images(color, depth)
    if not frames.pairs:
        raise InputError(
            f"{folder}: no color and depth images within {MAX_PAIR_SKEW_US // 1000} ms of each "
            "other; rgb.txt and depth.txt must be of one recording, with stamps in seconds"
        )
    return frames


def _check_files(pairs: list[FramePair]) -> None:
    """Raise InputError unless the files of the first frame and of most others exist."""
    missing_of_frame = [_missing_file(pair) for pair in pairs]
    missing = [image for image in missing_of_frame if image is not None]
    if missing_of_frame[0] is not None or 2 * len(missing) > len(pairs):
        raise InputError(
            f"{missing[0].location}: names {missing[0].file}, which is missing "
            f"({len(missing)} of {len(pairs)} frames lack a file); restore it or remove the line"
        )


def _missing_file(pair: FramePair) -> RecordedImage | None:
    return next((image for image in (pair.color, pair.depth) if not image.file.exists()), None)
