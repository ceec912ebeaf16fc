"""Depth comes out of its packing as it went in, and smaller where it can."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from vo_service.depth_packing import pack_depth
from vo_service.frame_record import max_packed_bytes, unpack_depth

Depth = NDArray[np.uint16]

shapes = st.tuples(st.integers(1, 12), st.integers(1, 12))
compiles = settings(deadline=None)  # the first time
near_values = st.sampled_from([0, 1, 126, 127, 128, 129, 254, 255, 256, 2000, 2127, 2128, 65535])


def packed(depth: Depth) -> bytes:
    """An image's packing; fails if it is larger than promised."""
    out = np.full(max_packed_bytes(depth.size) + 8, 0xA5, np.uint8)
    length = pack_depth(depth, out)
    assert length <= max_packed_bytes(depth.size)
    assert np.all(out[-8:] == 0xA5)
    return out[:length].tobytes()


@compiles
@given(shapes.flatmap(lambda shape: arrays(np.uint16, shape)))
def test_any_image_is_restored(depth: Depth) -> None:
    np.testing.assert_array_equal(unpack_depth(packed(depth), *depth.shape), depth)


@compiles
@given(shapes.flatmap(lambda shape: arrays(np.uint16, shape, elements=near_values)))
def test_depth_steps_and_holes_are_restored(depth: Depth) -> None:
    np.testing.assert_array_equal(unpack_depth(packed(depth), *depth.shape), depth)


def test_a_smooth_wall_takes_about_a_byte_per_pixel() -> None:
    depth = np.tile(np.arange(2000, 2640, dtype=np.uint16), (480, 1))
    depth[100:200, 100:300] = 0
    assert len(packed(depth)) <= 1.01 * depth.size


def test_pure_noise_is_stored_uncompressed() -> None:
    depth = np.random.default_rng(0).integers(1, 65535, (48, 64), np.uint16)
    assert packed(depth) == depth.tobytes()


@pytest.mark.parametrize("view", [np.s_[::2, ::2], np.s_[::-1, :]])
def test_a_non_contiguous_image_is_restored(view: tuple[slice, slice]) -> None:
    depth = np.random.default_rng(0).integers(900, 1000, (48, 64), np.uint16)[view]
    np.testing.assert_array_equal(unpack_depth(packed(depth), *depth.shape), depth)
