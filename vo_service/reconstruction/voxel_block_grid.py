"""Voxels kept only where there are surfaces: blocks of 8 x 8 x 8, found by their place in space.

Niessner et al., "Real-time 3D reconstruction at scale using voxel hashing", ACM Transactions on
Graphics 32(6), 2013: the table of blocks, not their contents.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel

BLOCK_SIDE = 8
VOXELS_PER_BLOCK = BLOCK_SIDE**3
# What a block takes: its voxels, and where it is.
BLOCK_BYTES = VOXELS_PER_BLOCK * (4 + 4 + 4 * 2) + 3 * 8

# EMPTY is no key: the table is then taken from the system as it is used, like the blocks.
EMPTY_KEY, OUT_OF_RANGE = 0, -1
NO_BLOCK = -1
# Bits of a coordinate in a key: with blocks of 8 cm, 84 km each way.
_COORDINATE_BITS = 21
_COORDINATE_LIMIT = 1 << (_COORDINATE_BITS - 1)
# The golden ratio in 64 bits (Knuth): neighbours in space land far apart in the table.
_HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)

BlockCoordinates = NDArray[np.int64]


class VoxelBlockGrid:
    """At most `capacity` blocks. Memory is taken from the system as blocks are used.

    count        how many there are
    refused      how often there was no room for one more
    coordinates  (capacity, 3) in blocks: block (x, y, z) begins at 8 voxels times this
    distance_m   (capacity, 512) to the nearest surface, positive in front of it
    weight       (capacity, 512) 1 for each reading as good as can be; 0 = never seen
    color       (capacity, 512, 4) red, green, blue in steps of 1/256, and the weight of these
    """

    def __init__(self, capacity: int) -> None:
        """Raises MemoryError."""
        self.capacity = capacity
        self.count = 0
        self.rejected = 0
        self.coordinates: BlockCoordinates = np.zeros((capacity, 3), np.int64)
        self.distance_m: NDArray[np.float32] = np.zeros((capacity, VOXELS_PER_BLOCK), np.float32)
        self.weight: NDArray[np.float32] = np.zeros((capacity, VOXELS_PER_BLOCK), np.float32)
        self.color: NDArray[np.uint16] = np.zeros((capacity, VOXELS_PER_BLOCK, 4), np.uint16)
        # Half of the table stays empty, so that searches are short.
        size = 1 << (2 * capacity - 1).bit_length()
        self.hash_table: NDArray[np.int64] = np.zeros((size, 2), np.int64)

    def allocate(self, requested: BlockCoordinates) -> None:
        """See that the blocks at these coordinates (N, 3) exist; those without room are counted."""
        self.count, refused = _insert_blocks(
            requested, self.hash_table, self.coordinates, self.count
        )
        self.rejected += refused


@kernel
def block_key(x: int, y: int, z: int) -> int:
    """One number for a block's place; OUT_OF_REACH if it is beyond what a key can tell."""
    if not (
        abs(x) < _COORDINATE_LIMIT and abs(y) < _COORDINATE_LIMIT and abs(z) < _COORDINATE_LIMIT
    ):
        return OUT_OF_RANGE
    return (
        ((x + _COORDINATE_LIMIT) << (2 * _COORDINATE_BITS))
        | ((y + _COORDINATE_LIMIT) << _COORDINATE_BITS)
        | (z + _COORDINATE_LIMIT)
    )


@kernel
def find_table_slot(key: int, table: NDArray[np.int64]) -> int:
    """Where in the table a key is, or would be put."""
    mask = np.uint64(len(table) - 1)
    place = (np.uint64(key) * _HASH_MULTIPLIER >> np.uint64(32)) & mask
    while table[place, 0] != key and table[place, 0] != EMPTY_KEY:
        place = (place + np.uint64(1)) & mask
    return np.int64(place)  # type: ignore[return-value]


@kernel
def block_index(x: int, y: int, z: int, table: NDArray[np.int64]) -> Any:
    """Number of the block at these coordinates; ABSENT if there is none."""
    key = block_key(x, y, z)
    if key == OUT_OF_RANGE:
        return NO_BLOCK
    place = find_table_slot(key, table)
    return table[place, 1] if table[place, 0] == key else NO_BLOCK


@kernel
def _insert_blocks(
    requested: BlockCoordinates, table: NDArray[np.int64], coordinates: BlockCoordinates, count: int
) -> tuple[int, int]:
    """The new count, and how many found no room."""
    refused = 0
    for n in range(len(requested)):
        key = block_key(requested[n, 0], requested[n, 1], requested[n, 2])
        if key == OUT_OF_RANGE:
            refused += 1
            continue
        place = find_table_slot(key, table)
        if table[place, 0] == key:
            continue
        if count == len(coordinates):
            refused += 1
            continue
        table[place, 0] = key
        table[place, 1] = count
        for axis in range(3):
            coordinates[count, axis] = requested[n, axis]
        count += 1
    return count, refused
