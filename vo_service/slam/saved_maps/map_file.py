"""A map as one file, so that a robot wakes up where it has been before."""

import hashlib
import os
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import is_disk_full
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.pose_graph import Node
from vo_service.slam.saved_maps.array_codec import pack_arrays, require_array, unpack_arrays
from vo_service.slam.saved_maps.map_arrays import (
    edges_from_arrays,
    graph_to_arrays,
    keyframes_from_arrays,
    keyframes_to_arrays,
    nodes_from_arrays,
)

SCHEMA = 1
# In front of everything: what the file is, its schema, how many bytes follow, and their SHA-256.
MAGIC = b"kinect-vo map\n\x00\x00"
HEADER = struct.Struct("<16sIQ32s")
# No map is larger: so much is read at most.
MAX_FILE_BYTES = 4 * 2**30
REMEDY = "name another map, or begin a new one"


@dataclass(frozen=True)
class MapContents:
    """All that is kept of a map.

    places       in the order of their numbers
    nodes        of the graph, one for each place
    edges        between them
    next_number  of the place that is made next: no number is used twice
    """

    keyframes: Sequence[MapKeyframe]
    nodes: Sequence[Node]
    edges: Sequence[Edge]
    next_number: int


def write_map(path: Path, contents: MapContents) -> None:
    """Write a map whole, for its owner alone: it shows the inside of a home.

    Whatever happens, even to the power, the file is the old one or the new one. Raises
    UserFacingError if it cannot be written.
    """
    data = _serialize(contents)
    header = HEADER.pack(MAGIC, SCHEMA, len(data), hashlib.sha256(data).digest())
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(header)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        cause = "the disk is full" if is_disk_full(error) else error.strerror
        raise UserFacingError(
            f"{path}: the map cannot be written: {cause}; mend that and save it again"
        ) from error


def read_map(path: Path) -> MapContents:
    """Read a map. Raises InputError for whatever is none, damaged, or of another version."""
    data = _read_verified(path)
    try:
        return _deserialize(data)
    except ValueError as error:
        raise InputError(f"{path}: no map of this program: it {error}; {REMEDY}") from None


def _serialize(contents: MapContents) -> bytes:
    return pack_arrays(
        {
            "next_number": np.array(contents.next_number, np.int64),
            **keyframes_to_arrays(contents.keyframes),
            **graph_to_arrays(contents.nodes, contents.edges),
        }
    )


def _deserialize(data: bytes) -> MapContents:
    arrays = unpack_arrays(data)
    places, nodes = keyframes_from_arrays(arrays), nodes_from_arrays(arrays)
    numbers = {place.number for place in places}
    if len(nodes) != len(places) or numbers != {node.number for node in nodes}:
        raise ValueError("has places that are not in its graph")
    next_number = int(require_array(arrays, "next_number", np.int64, ()))
    if next_number <= max(numbers, default=-1):
        raise ValueError("has used the number of its next place")
    return MapContents(places, nodes, edges_from_arrays(arrays, numbers), next_number)


def _read_verified(path: Path) -> bytes:
    """What follows the header. Raises InputError."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: there is no such file; {REMEDY}")
        with path.open("rb") as file:
            header, size = file.read(HEADER.size), os.fstat(file.fileno()).st_size
            digest = _check_header(path, header, size)
            data = file.read(size - HEADER.size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; {REMEDY}") from error
    if hashlib.sha256(data).digest() != digest:
        raise InputError(f"{path}: a damaged map: its checksum is wrong; {REMEDY}")
    return data


def _check_header(path: Path, header: bytes, size: int) -> bytes:
    """The SHA-256 that a header tells. Raises InputError if it is none, or of another version."""
    if len(header) < HEADER.size or not header.startswith(MAGIC):
        raise InputError(f"{path}: no map of kinect-vo; {REMEDY}")
    _, schema, length, digest = HEADER.unpack(header)
    if schema != SCHEMA:
        raise InputError(
            f"{path}: a map of version {schema}, and this program reads version {SCHEMA}; {REMEDY}"
        )
    if HEADER.size + length != size or size > MAX_FILE_BYTES:
        raise InputError(f"{path}: a damaged map: its length is wrong; {REMEDY}")
    return bytes(digest)
