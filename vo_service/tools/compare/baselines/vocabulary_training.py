"""Training of a vocabulary of ORB descriptors, for ORB-SLAM3 without a vocabulary file."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vo_service.tools.compare.baselines.orb_vocabulary import DESCRIPTOR_BYTES, Descriptors

# Children of a node and levels of the tree, as ORB-SLAM3's own vocabulary has 10 and 6.
BRANCHES, LEVELS = 10, 4
L1_NORM, TF_IDF = 0, 0
MAX_ITERATIONS = 10
SEED = 1
# A column per bit, of values -1 and 1: the larger the product, the smaller the Hamming distance.
SignedBits = NDArray[np.float32]


def train_vocabulary(
    images: Sequence[Descriptors], branches: int = BRANCHES, levels: int = LEVELS
) -> str:
    """Cluster the descriptors of images hierarchically, by k-medians with a fixed seed.

    Args:
        images: (N, 32) descriptors of each image.
        branches: Maximum number of children of a node.
        levels: Maximum number of levels below the root.

    Returns:
        The vocabulary in text format.
    """
    descriptors = np.concatenate([np.empty((0, DESCRIPTOR_BYTES), np.uint8), *images])
    owners = np.repeat(np.arange(len(images)), [len(image) for image in images])
    lines = [f"{branches} {levels} {L1_NORM} {TF_IDF}"]
    lines += _grow_tree(descriptors, owners, branches, levels)
    # DBoW2 would read an empty last line as one more node.
    return "\n".join(lines)


def _grow_tree(
    descriptors: Descriptors, owners: NDArray[np.int64], branches: int, levels: int
) -> Iterator[str]:
    """Yield the nodes' lines by level; `owners` are the numbers of the descriptors' images."""
    generator = np.random.default_rng(SEED)
    bits = 2 * np.unpackbits(descriptors, axis=1).astype(np.float32) - 1
    images = int(owners.max(initial=0)) + 1
    number = 0
    level = [(0, np.arange(len(bits)))]
    for depth in range(1, levels + 1):
        next_level = []
        for parent, members in level:
            for median, chosen in _split(bits[members], branches, generator):
                number += 1
                own = members[chosen]
                is_word = depth == levels or bool(np.all(bits[own] == bits[own][0]))
                weight = np.log(images / len(np.unique(owners[own]))) if is_word else 0.0
                values = " ".join(map(str, np.packbits(median > 0)))
                yield f"{parent} {int(is_word)} {values} {float(weight):g}"
                if not is_word:
                    next_level.append((number, own))
        level = next_level


def _split(
    bits: SignedBits, count: int, generator: np.random.Generator
) -> Iterator[tuple[SignedBits, NDArray[np.int64]]]:
    """Yield the median and the members of at most `count` clusters, none of them empty."""
    if not len(bits):
        return
    medians = np.unique(bits[generator.permutation(len(bits))[:count]], axis=0)
    nearest = np.full(len(bits), -1)
    for _ in range(MAX_ITERATIONS):
        previous, nearest = nearest, np.argmax(bits @ medians.T, axis=1)
        if np.array_equal(nearest, previous):
            break
        used = np.unique(nearest)
        # The majority of each bit minimizes the sum of Hamming distances.
        sums = np.array([bits[nearest == cluster].sum(axis=0) for cluster in used])
        medians = np.where(sums >= 0, np.float32(1), np.float32(-1))
        nearest = np.searchsorted(used, nearest)
    for cluster in np.unique(nearest):
        yield medians[cluster], np.flatnonzero(nearest == cluster)
