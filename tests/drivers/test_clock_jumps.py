"""Which stamps of a recording are left out, and where its clock was set."""

from itertools import combinations, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock_jumps import MAX_STALE_FRAMES, split_at_jumps

HOUR = 3600


@pytest.mark.parametrize(
    ("position", "wrong"), [(0, HOUR), (1, HOUR), (50, HOUR), (50, -HOUR), (50, 49), (50, 48)]
)
def test_one_wrong_stamp_costs_its_own_image(position: int, wrong: int) -> None:
    stamps = [*range(100)]
    stamps.insert(position, wrong)
    (run,) = split_at_jumps(stamps)
    assert len(run) == 100


@pytest.mark.parametrize("back", [MAX_STALE_FRAMES + 1, 100, HOUR])
def test_a_clock_that_was_set_back_starts_a_run_without_a_loss(back: int) -> None:
    stamps = [*range(100), *range(100 - back, 200 - back)]
    assert split_at_jumps(stamps) == [[*range(100)], [*range(100, 200)]]


def test_a_short_rest_after_a_jump_is_left_out() -> None:
    first = [*range(100, 200)]
    assert len(split_at_jumps([*first, *range(MAX_STALE_FRAMES - 1)])) == 1
    assert len(split_at_jumps([*first, *range(MAX_STALE_FRAMES)])) == 2


def test_a_gap_is_no_jump() -> None:
    assert split_at_jumps([0, 1, HOUR, HOUR + 1]) == [[0, 1, 2, 3]]


@given(st.lists(st.integers(0, 9), max_size=9), st.integers(1, 4))
def test_no_other_selection_is_worth_more(stamps: list[int], jump_cost: int) -> None:
    def worth(images: tuple[int, ...]) -> int:
        jumps = sum(stamps[a] >= stamps[b] for a, b in pairwise(images))
        return len(images) - jump_cost * jumps

    runs = split_at_jumps(stamps, jump_cost)
    kept = tuple(image for run in runs for image in run)
    assert all(stamps[a] < stamps[b] for run in runs for a, b in pairwise(run))
    selections = (
        each for n in range(len(stamps) + 1) for each in combinations(range(len(stamps)), n)
    )
    assert worth(kept) == max(map(worth, selections))
