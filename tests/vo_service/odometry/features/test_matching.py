import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES, make_textured_image
from vo_service.odometry.features.extractor import Features, SurfExtractor
from vo_service.odometry.features.matching import match_descriptors, match_features

Table = NDArray[np.float32]


def random_descriptors(seed: int, n: int, size: int, largest: int) -> Table:
    random = np.random.default_rng(seed)
    return random.integers(-largest, largest + 1, (n, size)).astype(np.float32)


def features_of(descriptor: Table, sign: NDArray[np.float32]) -> Features:
    n = len(descriptor)
    zero = np.zeros(n, np.float32)
    return Features(np.zeros((n, 2), np.float32), zero, np.zeros((n, 2), np.float32), zero, sign,
                    descriptor)  # fmt: skip


def brute_force(query: Table, reference: Table, ratio: float) -> list[list[int]]:
    """Whole numbers, one pair at a time."""
    q, r = query.astype(int), reference.astype(int)
    squared = ((q[:, None] - r) ** 2).sum(axis=2)
    pairs = []
    for i, row in enumerate(squared):
        j = int(row.argmin())
        others = np.delete(row, j)
        is_mutual = squared[:, j].argmin() == i
        if is_mutual and (not len(others) or row[j] < ratio**2 * others.min()):
            pairs.append([i, j])
    return pairs


@settings(FIRST_CALL_COMPILES, max_examples=200)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 30), st.integers(1, 8),
    st.integers(1, 20), st.sampled_from([0.6, 0.75, 0.8, 0.9]),
)  # fmt: skip
@example(seed=5, n=5, k=4, size=2, largest=5, ratio=0.8)  # a second nearest at the very ratio
def test_matches_are_those_of_a_brute_force_search(
    seed: int, n: int, k: int, size: int, largest: int, ratio: float
) -> None:
    query = random_descriptors(seed, n, size, largest)
    reference = random_descriptors(seed + 1, k, size, largest)
    expected = brute_force(query, reference, ratio)
    assert match_descriptors(query, reference, ratio).tolist() == expected


def test_long_descriptors_are_compared_exactly() -> None:
    # Two references of length 300 that differ by one in one number of 64, the smallest step.
    query = np.zeros((1, 64), np.float32)
    query[0, 0] = 300
    far, near = query.copy(), query.copy()
    far[0, 1:3], near[0, 1:2] = 40, 40
    table = np.concatenate([far, near])
    assert match_descriptors(query, table, 0.72).tolist() == [[0, 1]]
    assert match_descriptors(query, table, 0.70).tolist() == []


@pytest.mark.parametrize(("second", "ratio", "matches"), [(5, 0.81, 1), (5, 0.79, 0), (4, 1.0, 0)])
def test_the_second_nearest_must_be_further_by_the_match_ratio(
    second: int, ratio: float, matches: int
) -> None:
    query = np.zeros((1, 2), np.float32)
    reference = np.array([[4, 0], [0, second]], np.float32)
    assert len(match_descriptors(query, reference, ratio)) == matches


def test_bright_blobs_are_never_matched_to_dark_ones() -> None:
    table = random_descriptors(0, 40, 64, 50)
    sign = np.where(np.arange(40) % 2, 1.0, -1.0).astype(np.float32)
    query, same, other = (features_of(table, s) for s in (sign, sign, -sign))
    assert match_features(query, same, 0.8).tolist() == [[n, n] for n in range(40)]
    pairs = match_features(query, other, 1.0)
    assert len(pairs) > 0
    assert np.all(query.sign[pairs[:, 0]] == other.sign[pairs[:, 1]])


@pytest.mark.parametrize("signs", [[1.0, 1.0], [-1.0, 1.0]])
def test_an_image_without_features_has_no_matches(signs: list[float]) -> None:
    some = features_of(random_descriptors(0, 2, 64, 9), np.array(signs, np.float32))
    none = features_of(np.empty((0, 64), np.float32), np.empty(0, np.float32))
    for query, reference in ((some, none), (none, some), (none, none)):
        assert match_features(query, reference, 0.8).shape == (0, 2)


def test_an_image_matches_itself_in_order() -> None:
    features = SurfExtractor(300).extract(make_textured_image(240, 320))
    pairs = match_features(features, features, 0.8)
    assert np.array_equal(pairs[:, 0], pairs[:, 1])
    assert np.all(np.diff(pairs[:, 0]) > 0)
    assert len(pairs) > 250
