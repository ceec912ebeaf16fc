from dataclasses import replace

import pytest

from drivers.core.geometry import Array
from tests.vo_service.slam.place_recognition.corner_keyframes import (
    BESIDE,
    HERE,
    make_pose,
    make_query,
)
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.place_recognizer import PlaceRecognizer


def placed(keyframe: MapKeyframe, *poses: Array) -> KeyframeDatabase:
    """The same keyframe at several poses."""
    keyframes = KeyframeDatabase(max_bytes=10**9)
    for number, T in enumerate(poses):
        keyframes.add(replace(keyframe, number=number, T_world_keyframe=T))
    return keyframes


def along(*positions_m: float) -> list[Array]:
    return [make_pose((path_m, 0.0, 0.0)) for path_m in positions_m]


def test_the_most_similar_keyframe_comes_first(
    recognizer: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    keyframes = KeyframeDatabase(max_bytes=10**9)
    keyframes.add(here)
    keyframes.add(elsewhere)
    view = make_query(recognizer, BESIDE)
    assert [
        keyframe.number for keyframe in keyframes.find_similar(view, 2, lambda keyframe: True)
    ] == [0, 1]
    assert keyframes.find_similar(view, 1, lambda keyframe: True) == [here]


def test_only_allowed_keyframes_are_searched(
    recognizer: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    keyframes = KeyframeDatabase(max_bytes=10**9)
    keyframes.add(here)
    keyframes.add(elsewhere)
    view = make_query(recognizer, HERE)
    assert keyframes.find_similar(view, 5, lambda keyframe: keyframe.number > 0) == [elsewhere]
    assert keyframes.find_similar(view, 5, lambda keyframe: False) == []


def test_keyframes_are_found_by_their_numbers(here: MapKeyframe) -> None:
    keyframes = placed(here, *along(0.0, 1.0, 2.0))
    keyframes.remove(1)
    assert len(keyframes) == 2
    assert [keyframe.number for keyframe in keyframes] == [0, 2]
    assert 1 not in keyframes
    assert keyframes[2].number == 2
    with pytest.raises(KeyError):
        keyframes.remove(1)


def test_numbers_increase(here: MapKeyframe) -> None:
    keyframes = placed(here, *along(0.0, 1.0))
    with pytest.raises(ValueError, match="not newer"):
        keyframes.add(replace(here, number=1))


def test_the_database_reports_when_it_exceeds_its_limit(here: MapKeyframe) -> None:
    keyframes, is_over = KeyframeDatabase(max_bytes=int(2.5 * here.size_bytes)), []
    for number in range(3):
        keyframes.add(replace(here, number=number))
        is_over.append(keyframes.is_over_capacity)
    keyframes.remove(1)
    assert [*is_over, keyframes.is_over_capacity] == [False, False, True, False]
    assert keyframes.size_bytes == 2 * here.size_bytes
