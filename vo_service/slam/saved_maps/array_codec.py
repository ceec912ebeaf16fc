"""Codec of named arrays: an index in JSON, then the numbers. Nothing in the data is executed.

The reader checks each array by `require_array`.
"""

import json
import struct
from collections.abc import Mapping
from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, is_rigid

Number = TypeVar("Number", bound=np.generic)
Arrays = Mapping[str, NDArray[np.generic]]

# Length of the index, before the index.
_INDEX_LENGTH = struct.Struct("<Q")
# NumPy dtypes, all little-endian.
SUPPORTED_DTYPES = frozenset({"|b1", "|i1", "<i8", "<f2", "<f4", "<f8"})
# Longest side of an array.
MAX_DIMENSION = 2**40
# Side of any length.
ANY_LENGTH = -1


def pack_arrays(arrays: Arrays) -> bytes:
    """Pack arrays of the supported dtypes."""
    index = {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()}
    text = json.dumps(index).encode()
    return b"".join([_INDEX_LENGTH.pack(len(text)), text, *(a.tobytes() for a in arrays.values())])


def unpack_arrays(data: bytes) -> dict[str, NDArray[np.generic]]:
    """Unpack arrays, each with its own memory.

    No memory is allocated before that many bytes are known to be in the data.

    Raises:
        ValueError: The data is not from `pack_arrays`.
    """
    if len(data) < _INDEX_LENGTH.size:
        raise ValueError("ends in its index")
    length = _INDEX_LENGTH.unpack_from(data)[0]
    position = _INDEX_LENGTH.size + length
    if position > len(data):
        raise ValueError("ends in its index")
    arrays = {}
    for name, (kind, shape) in _parse_index(data[_INDEX_LENGTH.size : position]).items():
        count = prod(shape)
        size = count * np.dtype(kind).itemsize
        if size > len(data) - position:
            raise ValueError(f"ends in {name}")
        arrays[name] = np.frombuffer(data, kind, count, position).reshape(shape).copy()
        position += size
    if position != len(data):
        raise ValueError("has data after its last array")
    return arrays


def _parse_index(text: bytes) -> dict[str, tuple[str, list[int]]]:
    try:
        index = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("has an index that is no JSON") from None
    if not isinstance(index, dict) or not all(map(_is_index_entry, index.values())):
        raise ValueError("has an invalid index")
    return index


def _is_index_entry(entry: object) -> bool:
    match entry:
        case [str(kind), list(shape)]:
            return kind in SUPPORTED_DTYPES and all(
                type(side) is int and 0 <= side <= MAX_DIMENSION for side in shape
            )
        case _:
            return False


def require_array(
    arrays: Arrays, name: str, dtype: type[Number], shape: tuple[int, ...]
) -> NDArray[Number]:
    """Return an array of finite numbers with this dtype and shape.

    Raises:
        ValueError: If they are not valid.
    """
    if name not in arrays:
        raise ValueError(f"has no {name}")
    array = arrays[name]
    has_shape = array.ndim == len(shape) and all(
        expected in (ANY_LENGTH, side) for expected, side in zip(shape, array.shape, strict=True)
    )
    if array.dtype != dtype or not has_shape or not np.all(np.isfinite(array)):
        raise ValueError(f"has an invalid {name}")
    typed: NDArray[Number] = array.astype(dtype, copy=False)
    return typed


def require_poses(arrays: Arrays, name: str, count: int) -> Array:
    """Return rigid transforms (count, 4, 4).

    Raises:
        ValueError: If they are not valid.
    """
    T = require_array(arrays, name, np.float64, (count, 4, 4))
    if not all(map(is_rigid, T)):
        raise ValueError(f"has an invalid {name}")
    return T
