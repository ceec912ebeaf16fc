"""What a view looks like in short: its features, summed up by the words that they are nearest to.

VLAD: Jegou, Douze, Schmid and Perez, "Aggregating local descriptors into a compact image
representation" (CVPR 2010), with each word's sum brought to the same length (Arandjelovic and
Zisserman, "All about VLAD", CVPR 2013).
"""

from dataclasses import dataclass
from importlib.resources import files
from typing import Self

import numpy as np
from numpy.typing import NDArray

# Summaries are whole numbers of this length: products of them are exact in float32, so that the
# likeness of two views is the same whatever the order that it is summed up in.
DESCRIPTOR_NORM = 1000.0


@dataclass(frozen=True, eq=False)
class VladVocabulary:
    """The words: (K, 64) float32 whole numbers, in the space of SURF descriptors."""

    cluster_centers: NDArray[np.float32]

    @classmethod
    def default(cls) -> Self:
        """Those that come along: `python -m benchmarks.train_vlad` made them."""
        with files(__package__).joinpath("vlad_vocabulary.npy").open("rb") as file:
            return cls(np.load(file, allow_pickle=False).astype(np.float32))

    def describe(self, descriptors: NDArray[np.generic]) -> NDArray[np.int8]:
        """(K * 64,) int8 of the length LENGTH, but for rounding, of descriptors (N, 64).

        Two views are as alike as the product of their summaries is large.
        """
        features = descriptors.astype(np.float32)
        nearest = self.assign_words(features)
        sums = np.zeros(self.cluster_centers.shape, np.float32)
        np.add.at(sums, nearest, features - self.cluster_centers[nearest])
        by_word = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1.0)
        whole = by_word.ravel() * (DESCRIPTOR_NORM / max(float(np.linalg.norm(by_word)), 1e-9))
        summary: NDArray[np.int8] = np.clip(np.rint(whole), -127, 127).astype(np.int8)
        return summary

    def assign_words(self, features: NDArray[np.float32]) -> NDArray[np.intp]:
        """(N,) the word of each of the features (N, 64)."""
        half_squares = 0.5 * np.einsum("kd,kd->k", self.cluster_centers, self.cluster_centers)
        closeness: NDArray[np.float32] = features @ self.cluster_centers.T - half_squares
        return np.asarray(closeness.argmax(axis=1), np.intp)
