"""Map file: keyframes, pose graph and cells, so that a robot can relocalize after a restart."""

import hashlib
import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.files import atomic_file
from drivers.core.input_files import open_input
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import MapKeyframe
from vo_service.slam.map_arrays import (
    cells_from_arrays,
    cells_to_arrays,
    edges_from_arrays,
    graph_to_arrays,
    keyframes_from_arrays,
    keyframes_to_arrays,
    nodes_from_arrays,
    pack_arrays,
    require_array,
    unpack_arrays,
)
from vo_service.slam.map_cells import NO_MAP_CELLS, MapCells
from vo_service.slam.pose_graph import Node

SCHEMA = 1
# Header: magic, schema, number of bytes that follow, and their SHA-256.
MAGIC = b"kinect-vo map\n\x00\x00"
HEADER = struct.Struct("<16sIQ32s")
# Largest map file.
MAX_FILE_BYTES = 4 * 2**30
REMEDY = "choose another map or start a new one"


@dataclass(frozen=True)
class MapContents:
    """Contents of a map file.

    Attributes:
        keyframes: In the order of their numbers.
        nodes: Of the pose graph, one for each keyframe.
        edges: Between the nodes.
        next_number: Number of the next keyframe: no number is used twice.
        cells: Of the occupancy grid.
    """

    keyframes: Sequence[MapKeyframe]
    nodes: Sequence[Node]
    edges: Sequence[Edge]
    next_number: int
    cells: MapCells = NO_MAP_CELLS


def write_map(path: Path, contents: MapContents) -> None:
    """Write a map atomically, readable by its owner only, as it shows the inside of a home.

    Raises:
        WriteError: The file cannot be written.
    """
    data = _serialize(contents)
    header = HEADER.pack(MAGIC, SCHEMA, len(data), hashlib.sha256(data).digest())
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    with atomic_file(path) as part:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, flags, 0o600), "wb") as file:
            file.write(header)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())


def read_map(path: Path) -> MapContents:
    """Read a map.

    Raises:
        InputError: If it is none, damaged, or of another version.
    """
    data = _read_verified(path)
    try:
        return _deserialize(data)
    except ValueError as error:
        raise InputError(f"{path}: invalid map: it {error}; {REMEDY}") from None


def _serialize(contents: MapContents) -> bytes:
    return pack_arrays(
        {
            "next_number": np.array(contents.next_number, np.int64),
            **keyframes_to_arrays(contents.keyframes),
            **graph_to_arrays(contents.nodes, contents.edges),
            **cells_to_arrays(contents.cells),
        }
    )


def _deserialize(data: bytes) -> MapContents:
    arrays = unpack_arrays(data)
    keyframes, nodes = keyframes_from_arrays(arrays), nodes_from_arrays(arrays)
    numbers = {keyframe.number for keyframe in keyframes}
    if len(nodes) != len(keyframes) or numbers != {node.number for node in nodes}:
        raise ValueError("has keyframes that are not in its graph")
    next_number = int(require_array(arrays, "next_number", np.int64, ()))
    if next_number <= max(numbers, default=-1):
        raise ValueError("has a keyframe with the number of the next one")
    edges, cells = edges_from_arrays(arrays, numbers), cells_from_arrays(arrays, numbers)
    return MapContents(keyframes, nodes, edges, next_number, cells)


def _read_verified(path: Path) -> bytes:
    """Read and verify the data after the header. Raises InputError."""
    try:
        with open_input(path) as file:
            header, size = file.read(HEADER.size), os.fstat(file.fileno()).st_size
            digest = _check_header(path, header, size)
            data = file.read(size - HEADER.size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; {REMEDY}") from error
    if hashlib.sha256(data).digest() != digest:
        raise InputError(f"{path}: damaged map: wrong checksum; {REMEDY}")
    return data


def _check_header(path: Path, header: bytes, size: int) -> bytes:
    """Return the header's SHA-256. Raises InputError if it is invalid or of another version."""
    if len(header) < HEADER.size or not header.startswith(MAGIC):
        raise InputError(f"{path}: not a kinect-vo map; {REMEDY}")
    _, schema, length, digest = HEADER.unpack(header)
    if schema != SCHEMA:
        raise InputError(f"{path}: map version {schema} is not supported, only {SCHEMA}; {REMEDY}")
    if HEADER.size + length != size or size > MAX_FILE_BYTES:
        raise InputError(f"{path}: damaged map: wrong length; {REMEDY}")
    return bytes(digest)
