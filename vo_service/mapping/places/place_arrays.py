"""Places as named arrays, and back. Summaries are left out: the descriptors tell them."""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.geometry import Array
from vo_service.mapping.places.array_bytes import ANY, Arrays, take, take_poses
from vo_service.mapping.places.landmarks import Landmarks
from vo_service.mapping.places.place import PackedPoints, Place
from vo_service.mapping.places.words import Words
from vo_service.odometry.keyframe.images import LEVELS
from vo_service.odometry.keyframe.points import BRIGHTNESS, COLUMNS
from vo_service.odometry.surf.descriptor import SIZE


def arrays_of_places(places: Sequence[Place]) -> dict[str, NDArray[np.generic]]:
    """What all places have, in one array each; then what is of another length in each place."""
    arrays: dict[str, NDArray[np.generic]] = {
        "place/number": np.array([place.number for place in places], np.int64),
        "place/world": np.array([place.world for place in places], np.int64),
        "place/stamp_s": np.array([place.stamp_s for place in places], np.float64),
        "place/T": np.array([place.T_world_place for place in places]).reshape(-1, 4, 4),
        "place/camera": np.array([astuple(place.camera) for place in places]).reshape(-1, 6),
        "place/brightness": np.array([place.mean_brightness for place in places], np.float64),
        "place/levels": np.array([len(place.packed_points) for place in places], np.int64),
    }
    for n, place in enumerate(places):
        arrays[f"{n}/look"] = place.landmarks.look
        arrays[f"{n}/sign"] = place.landmarks.sign
        arrays[f"{n}/landmarks_m"] = place.landmarks.position_m
        for level, points in enumerate(place.packed_points):
            arrays[f"{n}/points_m/{level}"] = points.position_m
            arrays[f"{n}/points/{level}"] = points.rest
    return arrays


def places_of(arrays: Arrays) -> list[Place]:
    """The places. Raises ValueError for arrays that are not those of places."""
    number = take(arrays, "place/number", np.int64, (ANY,))
    count = len(number)
    world = take(arrays, "place/world", np.int64, (count,))
    stamp_s = take(arrays, "place/stamp_s", np.float64, (count,))
    T_world_place = take_poses(arrays, "place/T", count)
    camera = take(arrays, "place/camera", np.float64, (count, 6))
    brightness = take(arrays, "place/brightness", np.float64, (count,))
    levels = take(arrays, "place/levels", np.int64, (count,))
    if np.any(number < 0) or np.any(np.diff(number) <= 0):
        raise ValueError("has places whose numbers do not rise")
    if np.any(camera[:, :4] <= 0) or np.any((levels < 1) | (levels > LEVELS)):
        raise ValueError("has places that no camera has seen")
    words = Words.shipped()
    places = []
    for n in range(count):
        landmarks = _landmarks(arrays, n)
        places.append(
            Place(
                number=int(number[n]),
                world=int(world[n]),
                stamp_s=float(stamp_s[n]),
                T_world_place=T_world_place[n],
                camera=_camera(camera[n]),
                landmarks=landmarks,
                summary=words.summary(landmarks.look),
                packed_points=tuple(_points(arrays, n, level) for level in range(levels[n])),
                mean_brightness=float(brightness[n]),
            )
        )
    return places


def _camera(values: Array) -> PinholeCamera:
    width, height, fx, fy, cx, cy = values.tolist()
    return PinholeCamera(int(width), int(height), fx, fy, cx, cy)


def _landmarks(arrays: Arrays, n: int) -> Landmarks:
    look = take(arrays, f"{n}/look", np.int8, (ANY, SIZE))
    sign = take(arrays, f"{n}/sign", np.int8, (len(look),))
    return Landmarks(look, sign, take(arrays, f"{n}/landmarks_m", np.float32, (len(look), 3)))


def _points(arrays: Arrays, n: int, level: int) -> PackedPoints:
    position_m = take(arrays, f"{n}/points_m/{level}", np.float32, (ANY, BRIGHTNESS))
    shape = (len(position_m), COLUMNS - BRIGHTNESS)
    return PackedPoints(position_m, take(arrays, f"{n}/points/{level}", np.float16, shape))
