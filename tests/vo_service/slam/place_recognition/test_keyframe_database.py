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


def placed(place: MapKeyframe, *poses: Array) -> KeyframeDatabase:
    """The same view, as if it had been seen from all of these."""
    places = KeyframeDatabase(max_bytes=10**9)
    for number, T in enumerate(poses):
        places.add(replace(place, number=number, T_world_keyframe=T))
    return places


def along(*ways_m: float) -> list[Array]:
    return [make_pose((way_m, 0.0, 0.0)) for way_m in ways_m]


def test_what_looks_alike_comes_first(
    recogniser: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    places = KeyframeDatabase(max_bytes=10**9)
    places.add(here)
    places.add(elsewhere)
    view = make_query(recogniser, BESIDE)
    assert [place.number for place in places.find_similar(view, 2, lambda place: True)] == [0, 1]
    assert places.find_similar(view, 1, lambda place: True) == [here]


def test_only_those_allowed_are_asked(
    recogniser: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    places = KeyframeDatabase(max_bytes=10**9)
    places.add(here)
    places.add(elsewhere)
    view = make_query(recogniser, HERE)
    assert places.find_similar(view, 5, lambda place: place.number > 0) == [elsewhere]
    assert places.find_similar(view, 5, lambda place: False) == []


def test_they_are_found_by_their_numbers(here: MapKeyframe) -> None:
    places = placed(here, *along(0.0, 1.0, 2.0))
    places.remove(1)
    assert len(places) == 2
    assert [place.number for place in places] == [0, 2]
    assert 1 not in places
    assert places[2].number == 2
    with pytest.raises(KeyError):
        places.remove(1)


def test_numbers_rise(here: MapKeyframe) -> None:
    places = placed(here, *along(0.0, 1.0))
    with pytest.raises(ValueError, match="no newer"):
        places.add(replace(here, number=1))


def test_they_say_when_they_take_too_much(here: MapKeyframe) -> None:
    places, is_over = KeyframeDatabase(max_bytes=int(2.5 * here.size_bytes)), []
    for number in range(3):
        places.add(replace(here, number=number))
        is_over.append(places.is_over_capacity)
    places.remove(1)
    assert [*is_over, places.is_over_capacity] == [False, False, True, False]
    assert places.size_bytes == 2 * here.size_bytes
