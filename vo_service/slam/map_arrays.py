"""Arrays of a saved map: packing into bytes, and conversion from and to its parts.

The bytes are an index in JSON, then the numbers. Nothing in the data is executed. The reader checks
each array by `require_array`.
"""

import json
import struct
from collections.abc import Mapping, Sequence, Set
from dataclasses import astuple
from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, is_rigid
from vo_service.navigation.local_grid import CellKind
from vo_service.odometry.direct.image_pyramid import NUM_LEVELS
from vo_service.odometry.features.descriptor import DESCRIPTOR_SIZE
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import (
    NUM_POINT_ATTRIBUTES,
    DepthFeatures,
    MapKeyframe,
    PackedPoints,
    VladVocabulary,
)
from vo_service.slam.map_cells import NO_MAP_CELLS, FrameCells, MapCells
from vo_service.slam.pose_graph import AnchoredPose, Node

Number = TypeVar("Number", bound=np.generic)
Arrays = Mapping[str, NDArray[np.generic]]

# Length of the index, before the index.
_INDEX_LENGTH = struct.Struct("<Q")
# NumPy dtypes, all little-endian.
SUPPORTED_DTYPES = frozenset({"|b1", "|i1", "<i2", "<i8", "<f2", "<f4", "<f8"})
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

    Args:
        shape: Its shape; `ANY_LENGTH` stands for any side.

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


def graph_to_arrays(nodes: Sequence[Node], edges: Sequence[Edge]) -> dict[str, NDArray[np.generic]]:
    """Convert nodes and edges to arrays, in their order."""
    return {
        "node/number": np.array([node.number for node in nodes], np.int64),
        "node/world": np.array([node.world_id for node in nodes], np.int64),
        "node/T_world": _stack_matrices([node.T_world_keyframe for node in nodes], 4),
        "node/T_map": _stack_matrices([node.T_map_keyframe for node in nodes], 4),
        "edge/ends": np.array([(edge.a, edge.b) for edge in edges], np.int64).reshape(-1, 2),
        "edge/T": _stack_matrices([edge.T_a_b for edge in edges], 4),
        "edge/covariance": _stack_matrices([edge.covariance for edge in edges], 6),
        "edge/is_loop": np.array([edge.is_loop for edge in edges], np.bool_),
        "edge/length_m": np.array([edge.length_m for edge in edges], np.float64),
    }


def nodes_from_arrays(arrays: Arrays) -> list[Node]:
    """Convert arrays to nodes.

    Raises:
        ValueError: If they are invalid.
    """
    number = require_array(arrays, "node/number", np.int64, (ANY_LENGTH,))
    world_id = require_array(arrays, "node/world", np.int64, (len(number),))
    T_world = require_poses(arrays, "node/T_world", len(number))
    T_map = require_poses(arrays, "node/T_map", len(number))
    rows = zip(number.tolist(), world_id.tolist(), T_world, T_map, strict=True)
    return [Node(*row) for row in rows]


def edges_from_arrays(arrays: Arrays, numbers: Set[int]) -> list[Edge]:
    """Convert arrays to edges between nodes of these numbers.

    Raises:
        ValueError: If they are not valid.
    """
    ends = require_array(arrays, "edge/ends", np.int64, (ANY_LENGTH, 2))
    count = len(ends)
    T = require_poses(arrays, "edge/T", count)
    covariance = require_array(arrays, "edge/covariance", np.float64, (count, 6, 6))
    is_loop = require_array(arrays, "edge/is_loop", np.bool_, (count,))
    length_m = require_array(arrays, "edge/length_m", np.float64, (count,))
    if not set(ends.ravel().tolist()) <= numbers or np.any(ends[:, 0] == ends[:, 1]):
        raise ValueError("has edges to missing keyframes")
    if np.any(length_m < 0) or not _are_positive_definite(covariance):
        raise ValueError("has invalid edges")
    rows = zip(*ends.T.tolist(), T, covariance, is_loop.tolist(), length_m.tolist(), strict=True)
    return [Edge(*row) for row in rows]


def _are_positive_definite(covariance: Array) -> bool:
    """Whether matrices (N, 6, 6) are symmetric, except for rounding, and positive definite."""
    if len(covariance) == 0:
        return True
    asymmetry = np.abs(covariance - covariance.transpose(0, 2, 1)).max(axis=(1, 2))
    magnitude = np.abs(covariance).max(axis=(1, 2))
    return bool(
        np.all(asymmetry <= 1e-6 * magnitude) and np.linalg.eigvalsh(covariance).min() > 0.0
    )


def _stack_matrices(matrices: Sequence[Array], side: int) -> Array:
    return np.array(matrices, np.float64).reshape(-1, side, side)


def keyframes_to_arrays(keyframes: Sequence[MapKeyframe]) -> dict[str, NDArray[np.generic]]:
    """Convert keyframes to arrays: common ones, then those with a different length per keyframe."""
    arrays: dict[str, NDArray[np.generic]] = {
        "place/number": np.array([keyframe.number for keyframe in keyframes], np.int64),
        "place/world": np.array([keyframe.world_id for keyframe in keyframes], np.int64),
        "place/stamp_s": np.array([keyframe.stamp_s for keyframe in keyframes], np.float64),
        "place/T": np.array([keyframe.T_world_keyframe for keyframe in keyframes]).reshape(
            -1, 4, 4
        ),
        "place/camera": np.array([astuple(keyframe.camera) for keyframe in keyframes]).reshape(
            -1, 6
        ),
        "place/brightness": np.array(
            [keyframe.mean_brightness for keyframe in keyframes], np.float64
        ),
        "place/levels": np.array([len(keyframe.packed_points) for keyframe in keyframes], np.int64),
    }
    for n, keyframe in enumerate(keyframes):
        arrays[f"{n}/look"] = keyframe.features.descriptor_int8
        arrays[f"{n}/sign"] = keyframe.features.sign
        arrays[f"{n}/landmarks_m"] = keyframe.features.position_m
        for level, points in enumerate(keyframe.packed_points):
            arrays[f"{n}/points_m/{level}"] = points.position_m
            arrays[f"{n}/points/{level}"] = points.attributes
    return arrays


def keyframes_from_arrays(arrays: Arrays) -> list[MapKeyframe]:
    """Convert arrays to keyframes.

    Raises:
        ValueError: If they are invalid.
    """
    number = require_array(arrays, "place/number", np.int64, (ANY_LENGTH,))
    count = len(number)
    world_id = require_array(arrays, "place/world", np.int64, (count,))
    stamp_s = require_array(arrays, "place/stamp_s", np.float64, (count,))
    T_world_keyframe = require_poses(arrays, "place/T", count)
    camera = require_array(arrays, "place/camera", np.float64, (count, 6))
    brightness = require_array(arrays, "place/brightness", np.float64, (count,))
    levels = require_array(arrays, "place/levels", np.int64, (count,))
    if np.any(number < 0) or np.any(np.diff(number) <= 0):
        raise ValueError("has keyframes whose numbers do not ascend")
    if np.any(camera[:, :4] <= 0) or np.any((levels < 1) | (levels > NUM_LEVELS)):
        raise ValueError("has keyframes with an invalid camera or number of levels")
    vocabulary = VladVocabulary.default()
    keyframes = []
    for n in range(count):
        features = _features_from_arrays(arrays, n)
        width, height, *intrinsics = camera[n].tolist()
        keyframes.append(
            MapKeyframe(
                number=int(number[n]),
                world_id=int(world_id[n]),
                stamp_s=float(stamp_s[n]),
                T_world_keyframe=T_world_keyframe[n],
                camera=PinholeCamera(int(width), int(height), *intrinsics),
                features=features,
                vlad_descriptor=vocabulary.describe(features.descriptor_int8),
                packed_points=tuple(
                    _points_from_arrays(arrays, n, level) for level in range(levels[n])
                ),
                mean_brightness=float(brightness[n]),
            )
        )
    return keyframes


def _features_from_arrays(arrays: Arrays, n: int) -> DepthFeatures:
    descriptor = require_array(arrays, f"{n}/look", np.int8, (ANY_LENGTH, DESCRIPTOR_SIZE))
    sign = require_array(arrays, f"{n}/sign", np.int8, (len(descriptor),))
    return DepthFeatures(
        descriptor,
        sign,
        require_array(arrays, f"{n}/landmarks_m", np.float32, (len(descriptor), 3)),
    )


def _points_from_arrays(arrays: Arrays, n: int, level: int) -> PackedPoints:
    position_m = require_array(arrays, f"{n}/points_m/{level}", np.float32, (ANY_LENGTH, 3))
    shape = (len(position_m), NUM_POINT_ATTRIBUTES)
    return PackedPoints(position_m, require_array(arrays, f"{n}/points/{level}", np.float16, shape))


_RESOLUTION, _ANCHOR, _POSE = "cells/resolution_m", "cells/anchor", "cells/T"
_COUNT, _CELLS = "cells/count", "cells/cells"
# In the file: a pose that is relative to the map.
_NO_KEYFRAME = -1


def cells_to_arrays(cells: MapCells) -> dict[str, NDArray[np.generic]]:
    """Convert cells to arrays; none without frames."""
    if not cells.frames:
        return {}
    poses = [frame.anchored_pose for frame in cells.frames]
    anchors = [
        _NO_KEYFRAME if pose.keyframe_number is None else pose.keyframe_number for pose in poses
    ]
    return {
        _RESOLUTION: np.array(cells.resolution_m, np.float64),
        _ANCHOR: np.array(anchors, np.int64),
        _POSE: np.array([pose.T_keyframe_camera for pose in poses], np.float64),
        _COUNT: np.array([len(frame.cells) for frame in cells.frames], np.int64),
        _CELLS: np.concatenate([frame.cells for frame in cells.frames]),
    }


def cells_from_arrays(arrays: Arrays, numbers: Set[int]) -> MapCells:
    """Convert arrays to cells; `NO_MAP_CELLS` if there are none.

    Args:
        numbers: Of the keyframes.

    Raises:
        ValueError: If they are invalid.
    """
    if _COUNT not in arrays:
        return NO_MAP_CELLS
    resolution_m = float(require_array(arrays, _RESOLUTION, np.float64, ()))
    counts = require_array(arrays, _COUNT, np.int64, (ANY_LENGTH,))
    anchors = require_array(arrays, _ANCHOR, np.int64, (len(counts),)).tolist()
    poses = require_poses(arrays, _POSE, len(counts))
    cells = require_array(arrays, _CELLS, np.int16, (ANY_LENGTH, 3))
    if resolution_m <= 0.0 or np.any(counts < 0) or counts.sum() != len(cells):
        raise ValueError("has an invalid number or size of cells")
    if not np.all(np.isin(cells[:, 2], list(CellKind))):
        raise ValueError("has cells of an unknown kind")
    if not set(anchors) <= numbers | {_NO_KEYFRAME}:
        raise ValueError("has cells at missing keyframes")
    parts = np.split(cells, np.cumsum(counts)[:-1])
    return MapCells(
        resolution_m,
        [
            FrameCells(AnchoredPose(None if anchor == _NO_KEYFRAME else anchor, T), part)
            for anchor, T, part in zip(anchors, poses, parts, strict=True)
        ],
    )
