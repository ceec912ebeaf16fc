import json
import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray

from vo_service.slam.map_arrays import (
    ANY_LENGTH,
    SUPPORTED_DTYPES,
    pack_arrays,
    require_array,
    require_poses,
    unpack_arrays,
)

ARRAYS = st.dictionaries(
    st.text(max_size=8),
    st.sampled_from(sorted(SUPPORTED_DTYPES)).flatmap(
        lambda kind: npst.arrays(kind, npst.array_shapes(min_dims=0, max_dims=3, min_side=0))
    ),
    max_size=4,
)


def with_index(index: object, rest: bytes = b"") -> bytes:
    text = json.dumps(index).encode()
    return struct.pack("<Q", len(text)) + text + rest


@settings(max_examples=20)
@given(ARRAYS)
def test_arrays_are_restored_unchanged(arrays: dict[str, NDArray[np.generic]]) -> None:
    again = unpack_arrays(pack_arrays(arrays))
    assert list(again) == list(arrays)
    for name, array in arrays.items():
        assert (again[name].dtype, again[name].shape) == (array.dtype, array.shape)
        assert again[name].tobytes() == array.tobytes()


@settings(max_examples=20)
@given(ARRAYS, st.data())
def test_truncated_or_changed_bytes_are_rejected_or_read(
    arrays: dict[str, NDArray[np.generic]], data: st.DataObject
) -> None:
    packed = bytearray(pack_arrays(arrays))
    keyframe = data.draw(st.integers(0, len(packed) - 1))
    packed[keyframe] ^= data.draw(st.integers(1, 255))
    with pytest.raises(ValueError):  # noqa: PT011 (of any text: it ends too early)
        unpack_arrays(bytes(packed)[:keyframe])
    with suppress(ValueError):
        unpack_arrays(bytes(packed))


@pytest.mark.parametrize(
    "index",
    [
        [],
        {"a": []},
        {"a": ["<f8", [-1]]},
        {"a": ["<f8", [True]]},
        {"a": ["<f8", [10**15]]},
        {"a": ["<f8", [10**12, 0, 10**30]]},
        {"a": ["<f8", [2**40, 2**40, 2**40]]},
        {"a": ["<f8", [0] * 100]},
        {"a": ["O", [1]]},
        {"a": ["<f8", [1]], "b": ["<f8", [2]]},
    ],
)
def test_an_index_of_another_format_is_rejected(index: object) -> None:
    with pytest.raises(ValueError, match=r"index|ends|after its last|reshape|dimension"):
        unpack_arrays(with_index(index, bytes(8)))


def test_deep_nesting_is_refused() -> None:
    text = b"[" * 100_000
    with pytest.raises(ValueError, match="JSON"):
        unpack_arrays(struct.pack("<Q", len(text)) + text)


def test_only_valid_arrays_are_accepted() -> None:
    arrays = {"a": np.ones((3, 2)), "b": np.array([np.nan])}
    assert require_array(arrays, "a", np.float64, (ANY_LENGTH, 2)).shape == (3, 2)
    for name, kind, shape in (
        ("a", np.float32, (3, 2)),
        ("a", np.float64, (2, 2)),
        ("a", np.float64, (3,)),
        ("b", np.float64, (1,)),
        ("c", np.float64, (1,)),
    ):
        with pytest.raises(ValueError, match="has"):
            require_array(arrays, name, kind, shape)


def test_poses_are_rigid() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    assert np.array_equal(require_poses({"T": poses}, "T", 2), poses)
    poses[1, 0, 0] = 1.1
    with pytest.raises(ValueError, match="invalid"):
        require_poses({"T": poses}, "T", 2)
