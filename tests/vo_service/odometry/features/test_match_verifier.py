import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo_service.odometry.features.match_verifier import MatchVerifier

PANORAMA = MatchVerifier(inlier_share_if_right=0.6, inlier_share_by_chance=0.1)


@pytest.mark.parametrize("matches", [20, 50, 100, 500])
def test_the_published_example_is_reproduced(matches: int) -> None:
    # Brown and Lowe, equation 13: more than 8.0 + 0.3 n, rounded to one digit.
    assert not PANORAMA.accepts(int(7.5 + 0.3 * matches), matches)
    assert PANORAMA.accepts(int(9.5 + 0.32 * matches), matches)


@given(st.integers(0, 200), st.integers(0, 200))
def test_more_inliers_never_reduce_the_confidence(inliers: int, outliers: int) -> None:
    if PANORAMA.accepts(inliers, inliers + outliers):
        assert PANORAMA.accepts(inliers + 1, inliers + outliers + 1)
    else:
        assert not PANORAMA.accepts(inliers, inliers + outliers + 1)


def test_a_few_matches_are_never_accepted() -> None:
    assert not PANORAMA.accepts(7, 7)
    assert not PANORAMA.accepts(0, 0)
