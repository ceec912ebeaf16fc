"""The map grows with what was seen, not with time."""

import pytest

from tests.vo_service.mapping.loops.corner_walk import STEPS, closer_after, sight
from tests.vo_service.mapping.loops.scripted import STEP_M, ahead, walked
from tests.vo_service.mapping.loops.scripted import sight as straight_on
from vo_service.mapping.loops.thinning import REPEATED_STEPS
from vo_service.mapping.spacing import STEP_M as ONE_STEP_M

LAST_M = 9 * STEP_M


@pytest.mark.parametrize(("steps", "stays"), [(REPEATED_STEPS - 0.1, False), (2.0, True)])
def test_a_place_that_is_nearly_where_one_was_goes_when_the_next_has_come(
    steps: float, stays: bool
) -> None:
    made, scripted = walked(off_m=0.0)
    scripted.shows = {1: ahead(ONE_STEP_M * steps)}
    repeated = made.see(straight_on(STEP_M + ONE_STEP_M * steps)).place.number
    scripted.shows = {}
    assert repeated in made.places
    change = made.see(straight_on(LAST_M))
    assert (repeated in made.places) is stays
    assert [removal.number for removal in change.removals] == ([] if stays else [repeated])
    assert set(made.graph.nodes) == {place.number for place in made.places}


def test_a_place_that_shows_one_nearby_that_is_not_plausible_stays() -> None:
    made, scripted = walked(off_m=0.0)
    scripted.shows = {1: ahead(0.1)}
    repeated = made.see(straight_on(LAST_M + 5.0)).place.number
    made.see(straight_on(LAST_M + 5.3))
    assert repeated in made.places


@pytest.mark.slow
def test_who_comes_by_again_adds_few_places() -> None:
    made = closer_after(STEPS + 1)
    once = len(made.places)
    for n in range(STEPS + 1, 4 * STEPS):
        made.see(sight(n))
    assert once == STEPS + 1
    assert len(made.places) <= 1.5 * once < 2 * STEPS
