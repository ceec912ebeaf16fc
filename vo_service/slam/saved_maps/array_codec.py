"""Named arrays as bytes, and back: an index in JSON, then the numbers. Nothing in it is ever run.

Whoever reads them says of each what it has to be: `take`.
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

# Length of the index, in front of it.
_INDEX_LENGTH = struct.Struct("<Q")
# Kinds of numbers, as NumPy names them, all little-endian.
SUPPORTED_DTYPES = frozenset({"|b1", "|i1", "<i8", "<f2", "<f4", "<f8"})
# No side of an array is longer.
MAX_DIMENSION = 2**40
# Any length, where an array may be as long as it likes.
ANY_LENGTH = -1


def pack_arrays(arrays: Arrays) -> bytes:
    """Arrays of the kinds above, one after the other."""
    index = {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()}
    text = json.dumps(index).encode()
    return b"".join([_INDEX_LENGTH.pack(len(text)), text, *(a.tobytes() for a in arrays.values())])


def unpack_arrays(data: bytes) -> dict[str, NDArray[np.generic]]:
    """The arrays again, each with memory of its own.

    Raises ValueError for anything that `pack` did not make. No memory is taken by a number in the
    data before that many bytes are known to be there.
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
        raise ValueError("goes on after its last array")
    return arrays


def _parse_index(text: bytes) -> dict[str, tuple[str, list[int]]]:
    try:
        index = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("its index is no JSON") from None
    if not isinstance(index, dict) or not all(map(_is_index_entry, index.values())):
        raise ValueError("its index is none of arrays")
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
    """An array of finite numbers of this kind and shape. Raises ValueError if there is none."""
    if name not in arrays:
        raise ValueError(f"has no {name}")
    array = arrays[name]
    is_of_shape = array.ndim == len(shape) and all(
        wanted in (ANY_LENGTH, side) for wanted, side in zip(shape, array.shape, strict=True)
    )
    if array.dtype != dtype or not is_of_shape or not np.all(np.isfinite(array)):
        raise ValueError(f"has a {name} that cannot be")
    typed: NDArray[Number] = array.astype(dtype, copy=False)
    return typed


def require_poses(arrays: Arrays, name: str, count: int) -> Array:
    """Rigid transforms (count, 4, 4). Raises ValueError if they are none."""
    T = require_array(arrays, name, np.float64, (count, 4, 4))
    if not all(map(is_rigid, T)):
        raise ValueError(f"has a {name} that cannot be")
    return T
