import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.recording.pairing import StampsUs, pair_nearest

WITHIN = 20_000


def rising(*stamps: int) -> StampsUs:
    return np.array(stamps, dtype=np.int64)


def brute_force(color: StampsUs, depth: StampsUs, within: int) -> list[tuple[int, int]]:
    """All pairs of all stamps, the closest free one first, again and again."""
    pairs: list[tuple[int, int]] = []
    free_color, free_depth = set(range(len(color))), set(range(len(depth)))
    while True:
        near = [(abs(int(color[i]) - int(depth[j])), i, j) for i in free_color for j in free_depth]
        if not near or min(near)[0] > within:
            return sorted(pairs)
        _, i, j = min(near)
        pairs.append((i, j))
        free_color.remove(i)
        free_depth.remove(j)


stamps = st.sets(st.integers(0, 300), max_size=12).map(lambda s: rising(*sorted(s)))


@given(stamps, stamps, st.integers(0, 60))
def test_pairs_are_those_of_the_brute_force_greedy(
    color: StampsUs, depth: StampsUs, within: int
) -> None:
    assert pair_nearest(color, depth, within) == brute_force(color, depth, within)


@given(stamps, stamps, st.integers(0, 60))
def test_a_further_neighbor_is_never_used_while_the_nearer_is_free(
    color: StampsUs, depth: StampsUs, within: int
) -> None:
    pairs = pair_nearest(color, depth, within)
    of_color, of_depth = dict(pairs), {j: i for i, j in pairs}
    assert len(of_color) == len(of_depth) == len(pairs)
    for i in range(len(color)):
        for j in range(len(depth)):
            gap = abs(color[i] - depth[j])
            mine = abs(color[i] - depth[of_color[i]]) if i in of_color else within + 1
            its = abs(color[of_depth[j]] - depth[j]) if j in of_depth else within + 1
            assert gap >= min(mine, its)


def test_an_image_has_one_partner_only() -> None:
    assert pair_nearest(rising(0, 10_000), rising(8_000), WITHIN) == [(1, 0)]


def test_the_maximum_distance_is_inclusive() -> None:
    assert pair_nearest(rising(0), rising(20_000), WITHIN) == [(0, 0)]
    assert pair_nearest(rising(0), rising(20_001), WITHIN) == []


def test_empty_lists_have_no_pairs() -> None:
    assert pair_nearest(rising(), rising(1), WITHIN) == []


def test_an_hour_at_30_hz_is_paired_quickly() -> None:
    """All against all would be 10^10 candidates: hours, and more memory than there is."""
    color = np.arange(108_000, dtype=np.int64) * 33_333
    assert pair_nearest(color, color + 9_000, WITHIN) == [(k, k) for k in range(108_000)]
