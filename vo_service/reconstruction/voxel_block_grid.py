"""Sparse voxel grid: blocks of 8 x 8 x 8 voxels near surfaces, in a hash table by coordinates.

The table follows Niessner et al., "Real-time 3D reconstruction at scale using voxel hashing", ACM
Transactions on Graphics 32(6), 2013.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.config import Field
from drivers.core.jit import kernel

# Lower bounds of the truncation distance. A smaller one would not merge a surface that was seen
# twice with a pose error of some centimeters.
MIN_TRUNCATION_VOXELS, MIN_TRUNCATION_M = 4.0, 0.06


@dataclass(frozen=True)
class TsdfConfig:
    """Resolution and limits of a map; the memory limit includes mesh extraction."""

    voxel_m: Annotated[float, Field("voxel size, in meters", minimum=0.002, maximum=0.5)] = 0.01
    memory_mb: Annotated[
        int, Field("memory limit of the map; later surfaces are left out", minimum=20)
    ] = 1000
    max_depth_m: Annotated[
        float,
        Field("surfaces farther from the camera are left out", minimum=0.1, maximum=20.0),
    ] = 4.0

    @property
    def truncation_m(self) -> float:
        """Distance from a surface up to which the signed distance is stored."""
        return max(MIN_TRUNCATION_VOXELS * self.voxel_m, MIN_TRUNCATION_M)


BLOCK_SIDE = 8
VOXELS_PER_BLOCK = BLOCK_SIDE**3
# Memory of a block: its voxels and its coordinates.
BLOCK_BYTES = VOXELS_PER_BLOCK * (4 + 4 + 4 * 2) + 3 * 8

# An empty slot is zero, so the system provides the table's memory only as it is used.
EMPTY_KEY, OUT_OF_RANGE = 0, -1
NO_BLOCK = -1
# Bits per coordinate in a key: 84 km in each direction with blocks of 8 cm.
_COORDINATE_BITS = 21
_COORDINATE_LIMIT = 1 << (_COORDINATE_BITS - 1)
# The golden ratio in 64 bits (Knuth) spreads neighboring blocks over the table.
_HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)

BlockCoordinates = NDArray[np.int64]


class VoxelBlockGrid:
    """At most `capacity` blocks. The system provides their memory as they are used.

    Attributes:
        capacity: Greatest number of blocks.
        count: Number of blocks.
        rejected: How often a block did not fit.
        coordinates: (capacity, 3) in blocks; a block's first voxel is at 8 times this.
        distance_m: (capacity, 512) to the nearest surface, positive in front of it.
        weight: (capacity, 512) sum of weights, 1 for each best reading; 0 = never seen.
        color: (capacity, 512, 4) red, green, blue in steps of 1/256, and their weight.
        hash_table: (size, 2) key and block number.
    """

    def __init__(self, capacity: int) -> None:
        """Allocate the grid.

        Raises:
            MemoryError: If there is not enough memory.
        """
        self.capacity = capacity
        self.count = 0
        self.rejected = 0
        self.coordinates: BlockCoordinates = np.zeros((capacity, 3), np.int64)
        self.distance_m: NDArray[np.float32] = np.zeros((capacity, VOXELS_PER_BLOCK), np.float32)
        self.weight: NDArray[np.float32] = np.zeros((capacity, VOXELS_PER_BLOCK), np.float32)
        self.color: NDArray[np.uint16] = np.zeros((capacity, VOXELS_PER_BLOCK, 4), np.uint16)
        # At least half of the table stays empty, so that searches are short.
        size = 1 << (2 * capacity - 1).bit_length()
        self.hash_table: NDArray[np.int64] = np.zeros((size, 2), np.int64)

    def allocate(self, requested: BlockCoordinates) -> None:
        """Add the missing blocks among `requested` (N, 3); count those that do not fit."""
        self.count, rejected = _insert_blocks(
            requested, self.hash_table, self.coordinates, self.count
        )
        self.rejected += rejected


@kernel
def _block_key(x: int, y: int, z: int) -> int:
    """Encode block coordinates as one key; OUT_OF_RANGE if they are too large."""
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
    """Find the slot of a key, or the empty slot to put it in."""
    mask = np.uint64(len(table) - 1)
    slot = (np.uint64(key) * _HASH_MULTIPLIER >> np.uint64(32)) & mask
    while table[slot, 0] != key and table[slot, 0] != EMPTY_KEY:
        slot = (slot + np.uint64(1)) & mask
    return np.int64(slot)  # type: ignore[return-value]


@kernel
def block_index(x: int, y: int, z: int, table: NDArray[np.int64]) -> Any:
    """Return the number of the block at these coordinates; NO_BLOCK if there is none.

    Args:
        x, y, z: Block coordinates: position in the world over the side of a block.
        table: (capacity, 2) keys and numbers, see `VoxelBlockGrid`.
    """
    key = _block_key(x, y, z)
    if key == OUT_OF_RANGE:
        return NO_BLOCK
    slot = find_table_slot(key, table)
    return table[slot, 1] if table[slot, 0] == key else NO_BLOCK


@kernel
def _insert_blocks(
    requested: BlockCoordinates, table: NDArray[np.int64], coordinates: BlockCoordinates, count: int
) -> tuple[int, int]:
    """Insert missing blocks; return the new count and the number that did not fit."""
    rejected = 0
    for n in range(len(requested)):
        key = _block_key(requested[n, 0], requested[n, 1], requested[n, 2])
        if key == OUT_OF_RANGE:
            rejected += 1
            continue
        slot = find_table_slot(key, table)
        if table[slot, 0] == key:
            continue
        if count == len(coordinates):
            rejected += 1
            continue
        table[slot, 0] = key
        table[slot, 1] = count
        for axis in range(3):
            coordinates[count, axis] = requested[n, axis]
        count += 1
    return count, rejected
