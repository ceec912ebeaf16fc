"""Blocks are found where they were put, never twice, never more than there may be."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vo_service.reconstruction.voxel_block_grid import NO_BLOCK, VoxelBlockGrid, block_index

COORDINATE = st.one_of(st.integers(-3, 3), st.integers(1 - 2**20, 2**20 - 1))
PLACES = st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), max_size=40)


def put(blocks: VoxelBlockGrid, places: list[tuple[int, int, int]]) -> None:
    blocks.allocate(np.array(places, np.int64).reshape(-1, 3))


@settings(max_examples=40)
@given(PLACES, PLACES)
def test_each_block_is_there_once_and_no_other(
    places: list[tuple[int, int, int]], others: list[tuple[int, int, int]]
) -> None:
    blocks = VoxelBlockGrid(64)
    put(blocks, places)
    put(blocks, places[::-1])
    assert (blocks.count, blocks.rejected) == (len(set(places)), 0)
    for place in places:
        assert tuple(blocks.coordinates[block_index(*place, blocks.hash_table)]) == place
    for place in set(others) - set(places):
        assert block_index(*place, blocks.hash_table) == NO_BLOCK


@settings(max_examples=40)
@given(PLACES)
def test_beyond_the_bound_the_first_stay(places: list[tuple[int, int, int]]) -> None:
    blocks = VoxelBlockGrid(5)
    put(blocks, places)
    first = list(dict.fromkeys(places))[:5]
    assert [tuple(place) for place in blocks.coordinates[: blocks.count]] == first
    assert (blocks.rejected > 0) == (len(set(places)) > 5)


def test_what_is_too_far_for_a_key_is_refused() -> None:
    blocks = VoxelBlockGrid(5)
    put(blocks, [(2**20, 0, 0), (0, -(2**20), 0)])
    assert (blocks.count, blocks.rejected) == (0, 2)
    assert block_index(2**20, 0, 0, blocks.hash_table) == NO_BLOCK
