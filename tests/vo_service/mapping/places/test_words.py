import numpy as np
import pytest

from vo_service.mapping.places.words import LENGTH, Words


@pytest.fixture(scope="module")
def words() -> Words:
    return Words.shipped()


def test_the_shipped_words_are_different_whole_numbers(words: Words) -> None:
    assert words.centres.shape[1] == 64
    assert len(np.unique(words.centres, axis=0)) == len(words.centres) >= 32
    assert np.array_equal(words.centres, np.rint(words.centres))


def test_a_word_is_nearest_to_itself(words: Words) -> None:
    assert np.array_equal(words.nearest(words.centres), np.arange(len(words.centres)))


def test_a_summary_has_its_length_whatever_the_number_of_features(words: Words) -> None:
    random = np.random.default_rng(0)
    for count in (5, 50, 500):
        summary = words.summary(random.integers(-80, 80, (count, 64)))
        assert np.linalg.norm(summary.astype(float)) == pytest.approx(LENGTH, rel=0.05)


def test_a_summary_does_not_depend_on_the_order_of_the_features(words: Words) -> None:
    features = np.random.default_rng(1).integers(-80, 80, (300, 64)).astype(np.int8)
    assert np.array_equal(words.summary(features), words.summary(features[::-1]))


def test_no_features_are_summed_up_as_nothing(words: Words) -> None:
    assert not words.summary(np.empty((0, 64), np.int8)).any()
