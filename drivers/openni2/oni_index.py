"""The index of an .oni recording, read from its record headers.

libOpenNI2 plays such a file but does not report which image is next, when the file ends, or why it
stops early. The index gives this before the first image is played. The layout is that of the
library's file driver (Source/Drivers/OniFile/DataRecords.h).
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from drivers.camera import MAX_PAIR_SKEW_US
from drivers.core import InputError
from drivers.core.input_files import open_input
from drivers.openni2.bindings import SensorType
from drivers.recording.pairing import pair_nearest

FILE_HEADER = struct.Struct("<4sBBHIQI")
RECORD_HEADER = struct.Struct("<5IQ")
IMAGE_FIELDS = struct.Struct("<QI")
FILE_MAGIC, RECORD_MAGIC = b"NI10", 0x0052494E
FILE_VERSION = (1, 0, 1, 0)
IMAGE_RECORD, END_RECORD, NODE_ADDED_RECORD = 0x0A, 0x0B, 0x0D
SENSOR_TYPES = {2: SensorType.DEPTH, 3: SensorType.COLOR}
# Images farther apart in the file are not paired: one would stay in memory too long.
MAX_PAIR_DISTANCE_IMAGES = 60
# Sizes of the library's own buffers.
MAX_IMAGE_BYTES = 1600 * 1200 * 3
MAX_FIELDS_BYTES = 1 << 20


@dataclass(frozen=True)
class IndexedImage:
    """One image of the recording: its sensor and its stamp on the recording's clock."""

    sensor: SensorType
    stamp_us: int

    def __str__(self) -> str:
        return f"{self.sensor.name.lower()} image at {self.stamp_us / 1e6:.6f} s"


@dataclass(frozen=True)
class OniIndex:
    """The images of a recording and their pairs.

    Attributes:
        images: All depth and color images, in playback order.
        pairs: Positions in `images` of the color and the depth image of each pair, in order of
            time.
    """

    images: list[IndexedImage]
    pairs: list[tuple[int, int]]

    def stamp_s(self, position: int) -> float:
        """Return the stamp of one image in seconds."""
        return self.images[position].stamp_us / 1e6

    def skew_s(self, pair: tuple[int, int]) -> float:
        """Return the stamp of depth minus the stamp of color."""
        color, depth = pair
        return (self.images[depth].stamp_us - self.images[color].stamp_us) / 1e6


def read_oni_index(path: Path) -> OniIndex:
    """Read the index of a recording.

    Raises:
        InputError: If the file cannot be played to its end.
    """
    try:
        with open_input(path) as file:
            images = list(_read_images(file, path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give an .oni file") from error
    for sensor in SensorType:
        if not any(image.sensor is sensor for image in images):
            raise InputError(
                f"{path}: holds no {sensor.name.lower()} images; record color and depth together"
            )
    pairs = _pair_images(images)
    if not pairs:
        raise InputError(
            f"{path}: no color image within {MAX_PAIR_SKEW_US / 1e3:.0f} ms of a depth image; "
            "record both streams at once"
        )
    return OniIndex(images, pairs)


@dataclass(frozen=True)
class _Record:
    kind: int
    node: int
    fields: bytes
    payload_size: int


def _read_images(file: BinaryIO, path: Path) -> Iterator[IndexedImage]:
    """Yield the images of the first depth and the first color node, which the library plays."""
    nodes: dict[int, tuple[SensorType, int]] = {}
    for record in _read_records(file, path):
        if record.kind == NODE_ADDED_RECORD:
            sensor, count = _parse_node(record.fields, path)
            if sensor and sensor not in (node_sensor for node_sensor, _ in nodes.values()):
                nodes[record.node] = (sensor, count)
        elif record.kind == IMAGE_RECORD and record.node in nodes:
            sensor, count = nodes[record.node]
            stamp_us, number = IMAGE_FIELDS.unpack_from(record.fields)
            if number > count:
                raise _unfinished_error(path)
            yield IndexedImage(sensor, stamp_us)


def _read_records(file: BinaryIO, path: Path) -> Iterator[_Record]:
    """Yield all records before the end record."""
    size = os.fstat(file.fileno()).st_size
    _check_header(file.read(FILE_HEADER.size), path)
    while True:
        offset = file.tell()
        header = file.read(RECORD_HEADER.size)
        if not header:
            raise _unfinished_error(path)
        if len(header) < RECORD_HEADER.size:
            raise _truncated_error(path, offset)
        magic, kind, node, fields_size, payload_size, _ = RECORD_HEADER.unpack(header)
        fields_size -= RECORD_HEADER.size
        if magic != RECORD_MAGIC or not 0 <= fields_size <= MAX_FIELDS_BYTES:
            raise InputError(f"{path}: damaged at byte {offset}; copy or record it again")
        if offset + RECORD_HEADER.size + fields_size + payload_size > size:
            raise _truncated_error(path, offset)
        if kind == IMAGE_RECORD and (
            payload_size > MAX_IMAGE_BYTES or fields_size < IMAGE_FIELDS.size
        ):
            raise InputError(f"{path}: damaged image at byte {offset}; copy or record it again")
        if kind == END_RECORD:
            return
        yield _Record(kind, node, file.read(fields_size), payload_size)
        file.seek(payload_size, os.SEEK_CUR)


def _check_header(header: bytes, path: Path) -> None:
    if len(header) < FILE_HEADER.size or not header.startswith(FILE_MAGIC):
        raise InputError(f"{path}: is not an OpenNI recording (.oni)")
    version = FILE_HEADER.unpack(header)[1:5]
    if version != FILE_VERSION:
        raise InputError(
            f"{path}: its format has version {'.'.join(map(str, version))}, only "
            f"{'.'.join(map(str, FILE_VERSION))} is supported; record it with OpenNI2"
        )


def _parse_node(fields: bytes, path: Path) -> tuple[SensorType | None, int]:
    """Parse the sensor of a node and its number of images."""
    try:
        (name_size,) = struct.unpack_from("<I", fields)
        kind, _, count = struct.unpack_from("<I4sI", fields, 4 + name_size)
    except struct.error as error:
        raise InputError(f"{path}: damaged; copy or record it again") from error
    return SENSOR_TYPES.get(kind), count


def _pair_images(images: list[IndexedImage]) -> list[tuple[int, int]]:
    colors, depths = (_increasing_positions(images, sensor) for sensor in SensorType)
    stamps_us = np.array([image.stamp_us for image in images], dtype=np.int64)
    pairs = pair_nearest(stamps_us[colors], stamps_us[depths], MAX_PAIR_SKEW_US)
    positions = ((colors[i], depths[j]) for i, j in pairs)
    return [(i, j) for i, j in positions if abs(i - j) <= MAX_PAIR_DISTANCE_IMAGES]


def _increasing_positions(images: list[IndexedImage], sensor: SensorType) -> list[int]:
    """Return the positions of a sensor's images whose stamps rise."""
    positions, last_us = [], -1
    for position, image in enumerate(images):
        if image.sensor is sensor and image.stamp_us > last_us:
            positions.append(position)
            last_us = image.stamp_us
    return positions


def _unfinished_error(path: Path) -> InputError:
    return InputError(
        f"{path}: is unfinished (the recorder was killed or the disk was full), and libOpenNI2 "
        "cannot play it; record it again"
    )


def _truncated_error(path: Path, offset: int) -> InputError:
    return InputError(f"{path}: is truncated at byte {offset}; copy it again")
