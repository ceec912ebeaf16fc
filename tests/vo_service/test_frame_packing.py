"""Images come out of their packing as they went in, and smaller where they can."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from drivers.freenect.bayer import demosaic
from vo_service.frame_packing import pack_color, pack_depth
from vo_service.frame_record import max_packed_bytes, unpack_color, unpack_depth

Depth = NDArray[np.uint16]
Mosaic = NDArray[np.uint8]

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


def image_of(mosaic: Mosaic) -> NDArray[np.uint8]:
    color_bgr = np.empty((*mosaic.shape, 3), np.uint8)
    demosaic(mosaic, color_bgr)
    return color_bgr


def packed_color(color_bgr: NDArray[np.uint8]) -> bytes:
    out = np.empty(color_bgr.nbytes, np.uint8)
    return out[: pack_color(color_bgr, out)].tobytes()


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


even_shapes = st.tuples(st.integers(1, 6), st.integers(1, 6)).map(lambda n: (2 * n[0], 2 * n[1]))
mosaics = even_shapes.flatmap(lambda shape: arrays(np.uint8, shape))


@compiles
@given(mosaics)
def test_the_image_of_a_mosaic_takes_a_byte_per_pixel(mosaic: Mosaic) -> None:
    color_bgr = image_of(mosaic)
    packed = packed_color(color_bgr)
    assert packed == mosaic.tobytes()
    np.testing.assert_array_equal(unpack_color(packed, *mosaic.shape), color_bgr)


@compiles
@given(mosaics, st.data())
def test_an_image_that_differs_from_its_mosaic_anywhere_is_copied(
    mosaic: Mosaic, data: st.DataObject
) -> None:
    color_bgr = image_of(mosaic)
    y, x, channel = (data.draw(st.integers(0, size - 1)) for size in color_bgr.shape)
    is_of_mosaic = channel == [[1, 2], [0, 1]][y % 2][x % 2]
    color_bgr[y, x, channel] ^= 1
    packed = packed_color(color_bgr)
    assert (packed == color_bgr.tobytes()) or is_of_mosaic
    np.testing.assert_array_equal(unpack_color(packed, *mosaic.shape), color_bgr)


@compiles
@given(shapes.flatmap(lambda shape: arrays(np.uint8, (*shape, 3))))
def test_any_color_image_is_restored(color_bgr: NDArray[np.uint8]) -> None:
    packed = packed_color(color_bgr)
    np.testing.assert_array_equal(unpack_color(packed, *color_bgr.shape[:2]), color_bgr)
