"""What several tests of places need, made once."""

import pytest

from tests.vo_service.mapping.places.corner_places import ELSEWHERE, HERE, place_at
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.recognition import Recogniser


@pytest.fixture(scope="session")
def recogniser() -> Recogniser:
    """Gives the same whatever it has seen before."""
    return Recogniser()


@pytest.fixture(scope="session")
def here(recogniser: Recogniser) -> Place:
    """Place 0."""
    return place_at(recogniser, HERE)


@pytest.fixture(scope="session")
def elsewhere(recogniser: Recogniser) -> Place:
    """Place 1, with nothing in view that place 0 has."""
    return place_at(recogniser, ELSEWHERE, number=1)
