"""Vocabularies of ORB descriptors in the text format of DBoW2 (Gálvez-López and Tardós 2012).

The first line has k, L, scoring and weighting; each further line has one node: its parent's number,
whether it is a word, the 32 bytes of its descriptor, and its weight. The root is number 0 and has
no line.
"""

import hashlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from drivers.core import InputError
from drivers.core.input_files import open_input

# Children of a node and levels of the tree, as ORB-SLAM3's own vocabulary has 10 and 6.
BRANCHES, LEVELS = 10, 4
L1_NORM, TF_IDF = 0, 0
MAX_ITERATIONS = 10
SEED = 1

DESCRIPTOR_BYTES = 32
NODE_FIELDS = 2 + DESCRIPTOR_BYTES + 1
# Larger values are refused by DBoW2.
MAX_HEADER_VALUES = (20, 10, 5, 3)
MAX_LINE_BYTES = 1000

Descriptors = NDArray[np.uint8]
# A column per bit, of values -1 and 1: the larger the product, the smaller the Hamming distance.
SignedBits = NDArray[np.float32]


@dataclass(frozen=True)
class VocabularyFile:
    """A checked file with a vocabulary; `digest` is of its content."""

    path: Path
    digest: str

    def __str__(self) -> str:
        return f"{self.path.name} (sha256 {self.digest[:12]})"


def read_vocabulary_file(path: Path) -> VocabularyFile:
    """Check the header, the first node and the last one of a file.

    Raises:
        InputError: The file cannot be read, is truncated, or is not a vocabulary in text format.
    """
    try:
        with open_input(path) as file:
            fault = _find_fault(file)
            file.seek(0)
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"--orb-vocabulary {path}: cannot be read: {error.strerror}; give a DBoW2 vocabulary "
            "in text format, such as ORBvoc.txt"
        ) from error
    if fault:
        raise InputError(
            f"--orb-vocabulary {path}: {fault}; give a DBoW2 vocabulary in text format, such as "
            "ORBvoc.txt, unpacked"
        )
    return VocabularyFile(path.resolve(), digest)


def _find_fault(file: BinaryIO) -> str:
    """Return why a file is not a vocabulary; "" if it is one."""
    header = file.readline(MAX_LINE_BYTES).split()
    is_header = len(header) == len(MAX_HEADER_VALUES) and all(
        field.isdigit() and int(field) <= maximum
        for field, maximum in zip(header, MAX_HEADER_VALUES, strict=True)
    )
    if not is_header:
        return 'is not a vocabulary (its first line is not "k L scoring weighting")'
    if not _is_node(file.readline(MAX_LINE_BYTES)):
        return f"is not an ORB vocabulary (its second line does not have {NODE_FIELDS} numbers)"
    size = file.seek(0, io.SEEK_END)
    file.seek(max(0, size - MAX_LINE_BYTES))
    return "" if _is_node(file.read().rstrip().splitlines()[-1]) else "is truncated"


def _is_node(line: bytes) -> bool:
    *integers, weight = line.split() or [b""]
    try:
        float(weight)
    except ValueError:
        return False
    return len(integers) == NODE_FIELDS - 1 and all(field.isdigit() for field in integers)


@dataclass(frozen=True)
class _Node:
    parent: int
    is_word: bool
    descriptor: Descriptors
    weight: float


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
    lines += map(_format_node, _grow_tree(descriptors, owners, branches, levels))
    # DBoW2 would read an empty last line as one more node.
    return "\n".join(lines)


def _grow_tree(
    descriptors: Descriptors, owners: NDArray[np.int64], branches: int, levels: int
) -> Iterator[_Node]:
    """Yield the nodes level by level; `owners` are the numbers of the descriptors' images."""
    generator = np.random.default_rng(SEED)
    bits = _to_signed_bits(descriptors)
    images = int(owners.max(initial=0)) + 1
    number = 0
    level = [(0, np.arange(len(bits)))]
    for depth in range(1, levels + 1):
        next_level = []
        for parent, members in level:
            for median, chosen in _split(bits[members], branches, generator):
                number += 1
                own = members[chosen]
                is_word = depth == levels or _are_equal(bits[own])
                weight = np.log(images / len(np.unique(owners[own]))) if is_word else 0.0
                yield _Node(parent, is_word, _to_descriptor(median), float(weight))
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
        medians = np.array([_median(bits[nearest == cluster]) for cluster in used])
        nearest = np.searchsorted(used, nearest)
    for cluster in np.unique(nearest):
        yield medians[cluster], np.flatnonzero(nearest == cluster)


def _median(bits: SignedBits) -> SignedBits:
    """Return the majority of each bit, which minimizes the sum of Hamming distances."""
    return np.where(bits.sum(axis=0) >= 0, np.float32(1), np.float32(-1))


def _are_equal(bits: SignedBits) -> bool:
    return bool(np.all(bits == bits[0]))


def _to_signed_bits(descriptors: Descriptors) -> SignedBits:
    return 2 * np.unpackbits(descriptors, axis=1).astype(np.float32) - 1


def _to_descriptor(bits: SignedBits) -> Descriptors:
    return np.packbits(bits > 0)


def _format_node(node: _Node) -> str:
    values = " ".join(map(str, node.descriptor))
    return f"{node.parent} {int(node.is_word)} {values} {node.weight:g}"
