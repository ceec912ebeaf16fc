"""Writes uncompressed .oni recordings that the real libOpenNI2 plays bit for bit.

The layout is little-endian and packed: a header, then records, each with its own header, fields and
a payload. A stream is a node: it is declared with its properties, then its images follow. Counts
and last stamps are known only at the end and overwrite the initial values.
"""

import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame

MAGIC = b"NI10"
VERSION = (1, 0, 1, 0)
RECORD_MAGIC = 0x0052494E
DEPTH_1_MM, DEPTH_100_UM, RGB888 = 100, 101, 200


class OniRecordType(IntEnum):
    """Type of a record."""

    INT_PROPERTY = 0x03
    GENERAL_PROPERTY = 0x06
    NODE_REMOVED = 0x07
    DATA_BEGIN = 0x08
    STATE_READY = 0x09
    IMAGE = 0x0A
    END = 0x0B
    NODE_ADDED = 0x0D
    SEEK_TABLE = 0x0E


class OniSensor(IntEnum):
    """The stream of an image; the value is the node's type in the file."""

    DEPTH = 2
    COLOR = 3


@dataclass(frozen=True)
class OniImage:
    """One image: (height, width) uint16 depth, or (height, width, 3) uint8 BGR color."""

    sensor: OniSensor
    stamp_us: int
    pixels: NDArray[np.uint16] | NDArray[np.uint8]


@dataclass(frozen=True)
class OniSettings:
    """Properties of the streams.

    Attributes:
        fov_rad: Horizontal and vertical field of view of both streams.
        fps: Frames per second.
        mirror: Whether images are mirrored.
        depth_format: DEPTH_1_MM or DEPTH_100_UM: the unit of the depth values.
        cropping: False omits a property without which the player drops every image.
        finished: False leaves the counts at 0, as after a recorder was killed.
    """

    fov_rad: tuple[float, float] = (2 * math.atan(320 / 525), 2 * math.atan(240 / 525))
    fps: int = 30
    mirror: bool = False
    depth_format: int = DEPTH_1_MM
    cropping: bool = True
    finished: bool = True


def frames_to_oni_images(frames: Iterable[RgbdFrame]) -> Iterator[OniImage]:
    """Yield the images of each frame, depth first, in the order of a sensor's own recorder."""
    for frame in frames:
        stamp_us = round(frame.stamp_s * 1e6)
        depth_us = stamp_us + round(frame.skew_s * 1e6)
        yield OniImage(OniSensor.DEPTH, depth_us, frame.depth_raw)
        yield OniImage(OniSensor.COLOR, stamp_us, frame.color_bgr)


def write_oni(path: Path, images: Iterable[OniImage], settings: OniSettings | None = None) -> None:
    """Write `images` in their order. All images of a sensor have the same size.

    Images are read one at a time, so a long recording needs little memory.
    """
    with path.open("wb") as file:
        _OniWriter(file, settings or OniSettings()).write(iter(images))


@dataclass
class _OniNode:
    number: int
    sensor: OniSensor
    position: int
    last_image_position: int = 0
    index: list[tuple[int, int]] = field(default_factory=list)  # stamp, position


class _OniWriter:
    def __init__(self, file: BinaryIO, settings: OniSettings) -> None:
        self._file, self._settings = file, settings
        self._nodes: dict[OniSensor, _OniNode] = {}

    def write(self, images: Iterator[OniImage]) -> None:
        self._header()
        first, images = _first_of_each_sensor(images)
        for image in first:
            self._declare(image)
        for node in self._nodes.values():
            self._record(
                OniRecordType.DATA_BEGIN, node.number, struct.pack("<IQ", 0xFFFFFFFF, 2**64 - 1)
            )
        for image in images:
            self._image(image)
        if self._settings.finished:
            self._finish()

    def _header(self) -> None:
        last_us = max(
            (stamp for node in self._nodes.values() for stamp, _ in node.index), default=0
        )
        self._file.write(MAGIC + struct.pack("<BBHIQI", *VERSION, last_us, len(self._nodes)))

    def _declare(self, image: OniImage) -> None:
        node = _OniNode(len(self._nodes) + 1, image.sensor, self._file.tell())
        self._nodes[image.sensor] = node
        self._add_node(node)
        height, width = image.pixels.shape[:2]
        for name, number in self._int_properties(image).items():
            self._property(OniRecordType.INT_PROPERTY, node, name, struct.pack("<Q", number))
        mode = struct.pack("<3I", width, height, self._settings.fps)
        self._property(OniRecordType.GENERAL_PROPERTY, node, "xnSupportedMapOutputModes", mode)
        self._property(OniRecordType.GENERAL_PROPERTY, node, "xnMapOutputMode", mode)
        fov = struct.pack("<2d", *self._settings.fov_rad)
        self._property(OniRecordType.GENERAL_PROPERTY, node, "xnFOV", fov)
        if self._settings.cropping:
            whole = struct.pack("<I4H", 0, 0, 0, width, height)
            self._property(OniRecordType.GENERAL_PROPERTY, node, "xnCropping", whole)
        self._record(OniRecordType.STATE_READY, node.number)

    def _int_properties(self, image: OniImage) -> dict[str, int]:
        is_depth = image.sensor is OniSensor.DEPTH
        numbers = {
            "oniRequiredFrameSize": image.pixels.nbytes,
            "xnIsGenerating": 1,
            "xnSupportedMapOutputModesCount": 1,
            "xnPixelFormat": 4 if is_depth else 1,
            "oniPixelFormat": self._settings.depth_format if is_depth else RGB888,
            "xnMirror": int(self._settings.mirror),
        }
        return {**numbers, "xnDeviceMaxDepth": 10000} if is_depth else numbers

    def _add_node(self, node: _OniNode, seek_table_position: int = 0) -> None:
        stamps = [stamp for stamp, _ in node.index] or [0]
        name = _encode_string(f"{node.sensor.name.title()}1")
        kind = struct.pack("<I4sI", node.sensor, b"NONE", len(node.index))
        span = struct.pack("<3Q", stamps[0], max(stamps), seek_table_position)
        self._record(OniRecordType.NODE_ADDED, node.number, name + kind + span)

    def _property(self, kind: OniRecordType, node: _OniNode, name: str, data: bytes) -> None:
        self._record(kind, node.number, _encode_string(name) + struct.pack("<I", len(data)) + data)

    def _image(self, image: OniImage) -> None:
        node = self._nodes[image.sensor]
        previous, node.last_image_position = node.last_image_position, self._file.tell()
        node.index.append((image.stamp_us, node.last_image_position))
        fields = struct.pack("<QI", image.stamp_us, len(node.index))
        is_color = image.sensor is OniSensor.COLOR
        pixels = image.pixels[..., ::-1] if is_color else image.pixels
        self._record(OniRecordType.IMAGE, node.number, fields, pixels.tobytes(), previous)

    def _finish(self) -> None:
        tables = {}
        for node in self._nodes.values():
            self._record(OniRecordType.NODE_REMOVED, node.number)
            tables[node.number] = self._file.tell()
            entries = [struct.pack("<QIQ", 0, 0, 0)]
            entries += [struct.pack("<QIQ", stamp, 1, position) for stamp, position in node.index]
            self._record(OniRecordType.SEEK_TABLE, node.number, payload=b"".join(entries))
        self._record(OniRecordType.END, 0)
        self._file.seek(0)
        self._header()
        for node in self._nodes.values():
            self._file.seek(node.position)
            self._add_node(node, tables[node.number])

    def _record(
        self,
        kind: OniRecordType,
        node: int,
        fields: bytes = b"",
        payload: bytes = b"",
        undo: int = 0,
    ) -> None:
        size = 28 + len(fields)
        head = struct.pack("<5IQ", RECORD_MAGIC, kind, node, size, len(payload), undo)
        self._file.write(head + fields + payload)


def _encode_string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def _first_of_each_sensor(images: Iterator[OniImage]) -> tuple[list[OniImage], Iterator[OniImage]]:
    """Return the first image of each sensor, and an iterator over all images."""
    read: list[OniImage] = []
    first: dict[OniSensor, OniImage] = {}
    while len(first) < len(OniSensor) and (image := next(images, None)) is not None:
        read.append(image)
        first.setdefault(image.sensor, image)
    return list(first.values()), chain(read, images)
