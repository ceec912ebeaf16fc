"""A recording in the layout of the TUM RGB-D benchmark: its check, and its images."""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import CameraCalibration, find_calibration
from drivers.core.errors import InputError
from drivers.core.trajectory import Trajectory, read_trajectory
from drivers.time_sync import MAX_PAIR_SKEW_US, StampsUs, pair_nearest
from drivers.tum.index_files import (
    FramePair,
    GravitySeries,
    ListedImage,
    read_associations,
    read_gravity,
    read_image_list,
)

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
JPEG_SCAN = 0xDA

BgrImage = NDArray[np.uint8]
DepthImage = NDArray[np.uint16]


class UnreadableFrameError(Exception):
    """A frame's file is missing, broken or of the wrong kind: ``FILE: reason; action``."""


def load_pair(pair: FramePair, size: tuple[int, int]) -> tuple[BgrImage, DepthImage]:
    """Load the two images of a frame.

    Args:
        pair: The image files.
        size: (width, height) of the camera.

    Returns:
        Color (height, width, 3) BGR uint8 and depth (height, width) uint16.

    Raises:
        UnreadableFrameError: A file cannot be decoded or has the wrong size.
    """
    color = load_color(pair.color.file)
    depth = load_depth(pair.depth.file)
    if color.shape[:2] != depth.shape:
        raise UnreadableFrameError(
            f"{pair.color.file}: color is {_size_text(color)} but depth ({pair.depth.file}) is "
            f"{_size_text(depth)}; register the depth to the color image"
        )
    if depth.shape != size[::-1]:
        raise UnreadableFrameError(
            f"{pair.color.file}: the image is {_size_text(color)} but the camera is "
            f"{size[0]}x{size[1]}; give the camera file of these images"
        )
    return color, depth


def load_color(file: Path) -> BgrImage:
    """Load (height, width, 3) BGR uint8 from a PNG or JPEG.

    Raises:
        UnreadableFrameError: If an image cannot be read.
    """
    image = _load(file)
    if image.dtype != np.uint8:
        raise UnreadableFrameError(
            f"{file}: color does not have 8 bits per channel; give the color image here "
            "(in associations.txt color comes before depth)"
        )
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]
    if image.shape[2] == 4:
        return cv2.cvtColor(image, cv2.COLOR_BGRA2BGR)  # type: ignore[return-value]
    return image


def load_depth(file: Path) -> DepthImage:
    """Load (height, width) uint16 from a PNG.

    Raises:
        UnreadableFrameError: If an image cannot be read.
    """
    image = _load(file)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise UnreadableFrameError(
            f"{file}: depth has {image.dtype.itemsize * 8} bits and "
            f"{1 if image.ndim == 2 else image.shape[2]} channel(s), where 16 bits and 1 channel "
            "are needed; export the sensor's raw depth, not a visualization"
        )
    return image


def _load(file: Path) -> NDArray[Any]:
    """Load a complete PNG or JPEG as it is stored, channels in BGR order."""
    try:
        data = file.read_bytes()
    except OSError as error:
        raise UnreadableFrameError(f"{file}: cannot be read: {error.strerror}") from error
    fault = _find_fault(data)
    if fault:
        raise UnreadableFrameError(f"{file}: {fault}; restore it or remove it from the list")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UnreadableFrameError(f"{file}: cannot be decoded: {error.err}; replace it") from error
    if image is None:
        raise UnreadableFrameError(f"{file}: cannot be decoded; replace it")
    return image


def _find_fault(data: bytes) -> str:
    """Return why an image file is incomplete; "" if it is complete.

    OpenCV would fill missing parts with gray, or print to standard error.
    """
    if not data:
        return "is empty (0 bytes)"
    if data.startswith(PNG_SIGNATURE):
        return _find_png_fault(data)
    if data.startswith(JPEG_START):
        return _find_jpeg_fault(data)
    return "is not an image (neither PNG nor JPEG)"


def _find_png_fault(data: bytes) -> str:
    """Check the chunks (length, type, data, CRC) up to IEND: PNG specification, section 5."""
    position = len(PNG_SIGNATURE)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 12 + length
        if end > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[position + 4 : end - 4]) != crc:
            return "is damaged (a checksum of the PNG does not match)"
        if data[position + 4 : position + 8] == b"IEND":
            return ""
        position = end
    return f"is truncated (the PNG ends after {len(data)} bytes)"


def _find_jpeg_fault(data: bytes) -> str:
    """Check the segments up to the scan, then search the end marker: ITU-T T.81, annex B.

    In a scan 0xFF is always escaped, so an end marker there is not that of an embedded preview.
    """
    position = len(JPEG_START)
    while position + 4 <= len(data) and data[position] == 0xFF:
        if data[position + 1] == JPEG_SCAN:
            is_complete = data.find(JPEG_END, position) >= 0
            return "" if is_complete else f"is truncated (the JPEG ends after {len(data)} bytes)"
        (length,) = struct.unpack_from(">H", data, position + 2)
        position += 2 + length
    return "is truncated or damaged (the JPEG contains no image)"


def _size_text(image: NDArray[Any]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"


@dataclass(frozen=True)
class FolderFrames:
    """The frames of a folder, and the number of images without a partner."""

    pairs: list[FramePair]
    unpaired: int = 0


@dataclass(frozen=True)
class TumFolder:
    """A checked folder that can be replayed."""

    frames: FolderFrames
    calibration: CameraCalibration
    ground_truth: Trajectory | None
    gravity: GravitySeries


def open_tum_folder(folder: Path, camera_file: Path | None) -> TumFolder:
    """Read a folder's lists, camera, ground truth and gravity, and load its first frame.

    Raises:
        InputError: The folder cannot be used.
    """
    _check_folder(folder)
    frames = read_frame_pairs(folder)
    camera = find_calibration(folder, camera_file)
    _check_files(frames.pairs)
    try:
        load_pair(frames.pairs[0], (camera.width, camera.height))
    except UnreadableFrameError as error:
        location = frames.pairs[0].color.location
        raise InputError(f"{error} (the first frame, {location})") from error
    truth_file = folder / "groundtruth.txt"
    ground_truth = read_trajectory(truth_file) if truth_file.exists() else None
    return TumFolder(frames, camera, ground_truth, read_gravity(folder))


def _check_folder(folder: Path) -> None:
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; check the path")
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; unpack it and name the folder")
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    if empty:
        raise InputError(f"{folder}: the folder is empty; name one with rgb.txt and depth.txt")


def read_frame_pairs(folder: Path) -> FolderFrames:
    """Read the frames in a folder's lists, without its images and its camera.

    Raises:
        InputError: A list is missing or does not parse, or no two images can be paired.
    """
    associations = folder / "associations.txt"
    if associations.exists():
        return FolderFrames(read_associations(associations))
    for name in ("rgb.txt", "depth.txt"):
        if not (folder / name).exists():
            raise InputError(
                f"{folder / name}: no such file; a TUM folder holds rgb.txt and depth.txt, "
                "or associations.txt"
            )
    color, depth = read_image_list(folder / "rgb.txt"), read_image_list(folder / "depth.txt")
    indices = pair_nearest(_stamps_us(color), _stamps_us(depth), MAX_PAIR_SKEW_US)
    if not indices:
        raise InputError(
            f"{folder}: no color and depth images within {MAX_PAIR_SKEW_US // 1000} ms of each "
            "other; rgb.txt and depth.txt must be of one recording, with stamps in seconds"
        )
    pairs = [FramePair(color[i], depth[j]) for i, j in indices]
    return FolderFrames(pairs, len(color) + len(depth) - 2 * len(pairs))


def _stamps_us(images: list[ListedImage]) -> StampsUs:
    return np.array([int(image.stamp.scaleb(6).to_integral_value()) for image in images], np.int64)


def _check_files(pairs: list[FramePair]) -> None:
    """Raise InputError unless the files of the first frame and of most others exist."""
    missing_of_frame = [_missing_file(pair) for pair in pairs]
    missing = [image for image in missing_of_frame if image is not None]
    if missing_of_frame[0] is not None or 2 * len(missing) > len(pairs):
        raise InputError(
            f"{missing[0].location}: names {missing[0].file}, which is missing "
            f"({len(missing)} of {len(pairs)} frames lack a file); restore it or remove the line"
        )


def _missing_file(pair: FramePair) -> ListedImage | None:
    return next((image for image in (pair.color, pair.depth) if not image.file.is_file()), None)
