import numpy as np
import pytest

from vo_service.slam.place_recognition.vlad import DESCRIPTOR_NORM, VladVocabulary


@pytest.fixture(scope="module")
def vocabulary() -> VladVocabulary:
    return VladVocabulary.default()


def test_the_shipped_vocabulary_has_distinct_integers(vocabulary: VladVocabulary) -> None:
    assert vocabulary.cluster_centers.shape[1] == 64
    assert (
        len(np.unique(vocabulary.cluster_centers, axis=0)) == len(vocabulary.cluster_centers) >= 32
    )
    assert np.array_equal(vocabulary.cluster_centers, np.rint(vocabulary.cluster_centers))


def test_a_word_is_nearest_to_itself(vocabulary: VladVocabulary) -> None:
    assert np.array_equal(
        vocabulary.assign_words(vocabulary.cluster_centers),
        np.arange(len(vocabulary.cluster_centers)),
    )


def test_a_descriptor_has_its_length_whatever_the_number_of_features(
    vocabulary: VladVocabulary,
) -> None:
    random = np.random.default_rng(0)
    for count in (5, 50, 500):
        descriptor = vocabulary.describe(random.integers(-80, 80, (count, 64)))
        assert np.linalg.norm(descriptor.astype(float)) == pytest.approx(DESCRIPTOR_NORM, rel=0.05)


def test_a_descriptor_does_not_depend_on_the_order_of_the_features(
    vocabulary: VladVocabulary,
) -> None:
    features = np.random.default_rng(1).integers(-80, 80, (300, 64)).astype(np.int8)
    assert np.array_equal(vocabulary.describe(features), vocabulary.describe(features[::-1]))


def test_no_features_give_an_empty_descriptor(vocabulary: VladVocabulary) -> None:
    assert not vocabulary.describe(np.empty((0, 64), np.int8)).any()
