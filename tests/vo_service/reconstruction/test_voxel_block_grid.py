"""Blocks are found at their coordinates, never twice, never more than the capacity."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vo_service.reconstruction.voxel_block_grid import NO_BLOCK, VoxelBlockGrid, block_index

COORDINATE = st.one_of(st.integers(-3, 3), st.integers(1 - 2**20, 2**20 - 1))
COORDINATE_LISTS = st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), max_size=40)


def allocate(blocks: VoxelBlockGrid, coordinates: list[tuple[int, int, int]]) -> None:
    blocks.allocate(np.array(coordinates, np.int64).reshape(-1, 3))


@settings(max_examples=40)
@given(COORDINATE_LISTS, COORDINATE_LISTS)
def test_each_block_is_allocated_once(
    coordinates: list[tuple[int, int, int]], others: list[tuple[int, int, int]]
) -> None:
    blocks = VoxelBlockGrid(64)
    allocate(blocks, coordinates)
    allocate(blocks, coordinates[::-1])
    assert (blocks.count, blocks.rejected) == (len(set(coordinates)), 0)
    for coordinate in coordinates:
        assert tuple(blocks.coordinates[block_index(*coordinate, blocks.hash_table)]) == coordinate
    for coordinate in set(others) - set(coordinates):
        assert block_index(*coordinate, blocks.hash_table) == NO_BLOCK


@settings(max_examples=40)
@given(COORDINATE_LISTS)
def test_beyond_the_limit_the_first_blocks_stay(coordinates: list[tuple[int, int, int]]) -> None:
    blocks = VoxelBlockGrid(5)
    allocate(blocks, coordinates)
    first = list(dict.fromkeys(coordinates))[:5]
    assert [tuple(coordinate) for coordinate in blocks.coordinates[: blocks.count]] == first
    assert (blocks.rejected > 0) == (len(set(coordinates)) > 5)


def test_a_block_too_far_away_is_rejected() -> None:
    blocks = VoxelBlockGrid(5)
    allocate(blocks, [(2**20, 0, 0), (0, -(2**20), 0)])
    assert (blocks.count, blocks.rejected) == (0, 2)
    assert block_index(2**20, 0, 0, blocks.hash_table) == NO_BLOCK
