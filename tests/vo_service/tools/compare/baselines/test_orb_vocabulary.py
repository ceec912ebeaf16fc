"""Vocabularies of ORB descriptors: those that are trained, and files of the user."""

from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError
from vo_service.tools.compare.baselines.orb_vocabulary import (
    NODE_FIELDS,
    Descriptors,
    read_vocabulary_file,
)
from vo_service.tools.compare.baselines.vocabulary_training import train_vocabulary

CLUSTERS = np.array([[0] * 32, [255] * 32, [15] * 32], np.uint8)


def images(count: int = 4) -> list[Descriptors]:
    """Descriptors of three clusters, each one bit off its center at most."""
    rng = np.random.default_rng(0)
    flips = rng.integers(0, 2, (count, 60, 32), np.uint8)
    flips[:, :, 1:] = 0
    return [np.tile(CLUSTERS, (20, 1)) ^ flip for flip in flips]


def write_vocabulary(folder: Path, text: str) -> Path:
    file = folder / "vocabulary.txt"
    file.write_text(text)
    return file


def test_a_trained_vocabulary_has_a_header_and_a_line_for_each_node() -> None:
    header, *nodes = train_vocabulary(images(), branches=10, levels=2).split("\n")
    assert header == "10 2 0 0"
    parents = [int(node.split()[0]) for node in nodes]
    assert parents[0] == 0
    assert parents == sorted(parents)
    assert all(parent < number for number, parent in enumerate(parents, 1))
    assert {len(node.split()) for node in nodes} == {NODE_FIELDS}


def test_the_clusters_of_the_first_level_are_those_of_the_descriptors() -> None:
    nodes = train_vocabulary(images(), branches=10, levels=1).split("\n")[1:]
    centers = {tuple(map(int, node.split()[3:-1])) for node in nodes}
    assert centers == {tuple(cluster[1:].tolist()) for cluster in CLUSTERS}


def test_a_word_that_only_some_images_have_weighs_more() -> None:
    same, other = np.tile(CLUSTERS[:1], (5, 1)), np.tile(CLUSTERS[1:2], (5, 1))
    nodes = train_vocabulary([same, np.vstack([same, other])], 2, 1).split("\n")[1:]
    weights = {int(node.split()[2]): float(node.split()[-1]) for node in nodes}
    assert weights == {0: 0.0, 255: pytest.approx(np.log(2), rel=1e-5)}


def test_a_trained_vocabulary_is_accepted_as_a_file(tmp_path: Path) -> None:
    file = write_vocabulary(tmp_path, train_vocabulary(images()))
    checked = read_vocabulary_file(file)
    assert checked.path == file
    assert str(checked) == f"vocabulary.txt (sha256 {checked.digest[:12]})"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "is not a vocabulary"),
        ("10 4 0\n", "is not a vocabulary"),
        ("21 4 0 0\n", "is not a vocabulary"),
        ("10 4 0 0\n0 1 2 3\n", "is not an ORB vocabulary"),
        (train_vocabulary(images())[:-40], "is truncated"),
    ],
)
def test_another_file_is_one_line_with_what_to_give(tmp_path: Path, text: str, fault: str) -> None:
    file = write_vocabulary(tmp_path, text)
    with pytest.raises(InputError, match=f"--orb-vocabulary .*{fault}.*; give a DBoW2 vocabulary"):
        read_vocabulary_file(file)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_vocabulary_file(tmp_path / "none.txt")
