"""A map as one file, so that a robot wakes up where it has been before."""

import hashlib
import os
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import InputError, UserFacingError
from drivers.full_disk import is_full
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import Node
from vo_service.mapping.places.array_bytes import pack, take, unpack
from vo_service.mapping.places.graph_arrays import arrays_of_graph, edges_of, nodes_of
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.place_arrays import arrays_of_places, places_of

SCHEMA = 1
# In front of everything: what the file is, its schema, how many bytes follow, and their SHA-256.
MAGIC = b"kinect-vo map\n\x00\x00"
HEADER = struct.Struct("<16sIQ32s")
# No map is larger: so much is read at most.
MOST_BYTES = 4 * 2**30
WHAT_TO_DO = "name another map, or begin a new one"


@dataclass(frozen=True)
class MapContents:
    """All that is kept of a map.

    places       in the order of their numbers
    nodes        of the graph, one for each place
    edges        between them
    next_number  of the place that is made next: no number is used twice
    """

    places: Sequence[Place]
    nodes: Sequence[Node]
    edges: Sequence[Edge]
    next_number: int


def write_map(path: Path, contents: MapContents) -> None:
    """Write a map whole, for its owner alone: it shows the inside of a home.

    Whatever happens, even to the power, the file is the old one or the new one. Raises
    UserFacingError if it cannot be written.
    """
    data = _packed(contents)
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
        cause = "the disk is full" if is_full(error) else error.strerror
        raise UserFacingError(
            f"{path}: the map cannot be written: {cause}; mend that and save it again"
        ) from error


def read_map(path: Path) -> MapContents:
    """Read a map. Raises InputError for whatever is none, damaged, or of another version."""
    data = _read_checked(path)
    try:
        return _unpacked(data)
    except ValueError as error:
        raise InputError(f"{path}: no map of this program: it {error}; {WHAT_TO_DO}") from None


def _packed(contents: MapContents) -> bytes:
    return pack(
        {
            "next_number": np.array(contents.next_number, np.int64),
            **arrays_of_places(contents.places),
            **arrays_of_graph(contents.nodes, contents.edges),
        }
    )


def _unpacked(data: bytes) -> MapContents:
    arrays = unpack(data)
    places, nodes = places_of(arrays), nodes_of(arrays)
    numbers = {place.number for place in places}
    if len(nodes) != len(places) or numbers != {node.number for node in nodes}:
        raise ValueError("has places that are not in its graph")
    next_number = int(take(arrays, "next_number", np.int64, ()))
    if next_number <= max(numbers, default=-1):
        raise ValueError("has used the number of its next place")
    return MapContents(places, nodes, edges_of(arrays, numbers), next_number)


def _read_checked(path: Path) -> bytes:
    """What follows the header. Raises InputError."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: there is no such file; {WHAT_TO_DO}")
        with path.open("rb") as file:
            header, size = file.read(HEADER.size), os.fstat(file.fileno()).st_size
            digest = _digest(path, header, size)
            data = file.read(size - HEADER.size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; {WHAT_TO_DO}") from error
    if hashlib.sha256(data).digest() != digest:
        raise InputError(f"{path}: a damaged map: its checksum is wrong; {WHAT_TO_DO}")
    return data


def _digest(path: Path, header: bytes, size: int) -> bytes:
    """The SHA-256 that a header tells. Raises InputError if it is none, or of another version."""
    if len(header) < HEADER.size or not header.startswith(MAGIC):
        raise InputError(f"{path}: no map of kinect-vo; {WHAT_TO_DO}")
    _, schema, length, digest = HEADER.unpack(header)
    if schema != SCHEMA:
        raise InputError(
            f"{path}: a map of version {schema}, and this program reads version {SCHEMA}; "
            f"{WHAT_TO_DO}"
        )
    if HEADER.size + length != size or size > MOST_BYTES:
        raise InputError(f"{path}: a damaged map: its length is wrong; {WHAT_TO_DO}")
    return bytes(digest)
