"""Places as named arrays, and back. Summaries are left out: the descriptors tell them."""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.geometry import Array
from vo_service.mapping.places.array_bytes import ANY_LENGTH, Arrays, require_array, require_poses
from vo_service.mapping.places.landmarks import DepthFeatures
from vo_service.mapping.places.place import MapKeyframe, PackedPoints
from vo_service.mapping.places.words import VladVocabulary
from vo_service.odometry.keyframe.images import NUM_LEVELS
from vo_service.odometry.keyframe.points import NUM_POINT_COLUMNS, POINT_BRIGHTNESS
from vo_service.odometry.surf.descriptor import DESCRIPTOR_SIZE


def keyframes_to_arrays(keyframes: Sequence[MapKeyframe]) -> dict[str, NDArray[np.generic]]:
    """What all places have, in one array each; then what is of another length in each place."""
    arrays: dict[str, NDArray[np.generic]] = {
        "place/number": np.array([place.number for place in keyframes], np.int64),
        "place/world": np.array([place.world_id for place in keyframes], np.int64),
        "place/stamp_s": np.array([place.stamp_s for place in keyframes], np.float64),
        "place/T": np.array([place.T_world_keyframe for place in keyframes]).reshape(-1, 4, 4),
        "place/camera": np.array([astuple(place.camera) for place in keyframes]).reshape(-1, 6),
        "place/brightness": np.array([place.mean_brightness for place in keyframes], np.float64),
        "place/levels": np.array([len(place.packed_points) for place in keyframes], np.int64),
    }
    for n, place in enumerate(keyframes):
        arrays[f"{n}/look"] = place.features.descriptor_int8
        arrays[f"{n}/sign"] = place.features.sign
        arrays[f"{n}/landmarks_m"] = place.features.position_m
        for level, points in enumerate(place.packed_points):
            arrays[f"{n}/points_m/{level}"] = points.position_m
            arrays[f"{n}/points/{level}"] = points.attributes
    return arrays


def keyframes_from_arrays(arrays: Arrays) -> list[MapKeyframe]:
    """The places. Raises ValueError for arrays that are not those of places."""
    number = require_array(arrays, "place/number", np.int64, (ANY_LENGTH,))
    count = len(number)
    world = require_array(arrays, "place/world", np.int64, (count,))
    stamp_s = require_array(arrays, "place/stamp_s", np.float64, (count,))
    T_world_place = require_poses(arrays, "place/T", count)
    camera = require_array(arrays, "place/camera", np.float64, (count, 6))
    brightness = require_array(arrays, "place/brightness", np.float64, (count,))
    levels = require_array(arrays, "place/levels", np.int64, (count,))
    if np.any(number < 0) or np.any(np.diff(number) <= 0):
        raise ValueError("has places whose numbers do not rise")
    if np.any(camera[:, :4] <= 0) or np.any((levels < 1) | (levels > NUM_LEVELS)):
        raise ValueError("has places that no camera has seen")
    words = VladVocabulary.default()
    places = []
    for n in range(count):
        landmarks = _features_from_arrays(arrays, n)
        places.append(
            MapKeyframe(
                number=int(number[n]),
                world_id=int(world[n]),
                stamp_s=float(stamp_s[n]),
                T_world_keyframe=T_world_place[n],
                camera=_camera_from_array(camera[n]),
                features=landmarks,
                vlad_descriptor=words.describe(landmarks.descriptor_int8),
                packed_points=tuple(
                    _points_from_arrays(arrays, n, level) for level in range(levels[n])
                ),
                mean_brightness=float(brightness[n]),
            )
        )
    return places


def _camera_from_array(values: Array) -> PinholeCamera:
    width, height, fx, fy, cx, cy = values.tolist()
    return PinholeCamera(int(width), int(height), fx, fy, cx, cy)


def _features_from_arrays(arrays: Arrays, n: int) -> DepthFeatures:
    look = require_array(arrays, f"{n}/look", np.int8, (ANY_LENGTH, DESCRIPTOR_SIZE))
    sign = require_array(arrays, f"{n}/sign", np.int8, (len(look),))
    return DepthFeatures(
        look, sign, require_array(arrays, f"{n}/landmarks_m", np.float32, (len(look), 3))
    )


def _points_from_arrays(arrays: Arrays, n: int, level: int) -> PackedPoints:
    position_m = require_array(
        arrays, f"{n}/points_m/{level}", np.float32, (ANY_LENGTH, POINT_BRIGHTNESS)
    )
    shape = (len(position_m), NUM_POINT_COLUMNS - POINT_BRIGHTNESS)
    return PackedPoints(position_m, require_array(arrays, f"{n}/points/{level}", np.float16, shape))
