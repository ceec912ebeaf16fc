"""VLAD descriptors of views: features aggregated by their nearest visual words.

VLAD: Jegou, Douze, Schmid and Perez, "Aggregating local descriptors into a compact image
representation" (CVPR 2010), with each word's sum normalized (Arandjelovic and
Zisserman, "All about VLAD", CVPR 2013).
"""

from dataclasses import dataclass
from importlib.resources import files
from typing import Self

import numpy as np
from numpy.typing import NDArray

# Descriptors are whole numbers with this norm: their products are exact in float32 in any order of
# summation.
DESCRIPTOR_NORM = 1000.0


@dataclass(frozen=True, eq=False)
class VladVocabulary:
    """Visual words, cluster centers (K, 64) of SURF descriptors: float32 whole numbers."""

    cluster_centers: NDArray[np.float32]

    @classmethod
    def default(cls) -> Self:
        """Load the packaged vocabulary, made by `python -m benchmarks train_vlad`."""
        with files(__package__).joinpath("vlad_vocabulary.npy").open("rb") as file:
            return cls(np.load(file, allow_pickle=False).astype(np.float32))

    def describe(self, descriptors: NDArray[np.generic]) -> NDArray[np.int8]:
        """Aggregate descriptors (N, 64) to a VLAD descriptor (K * 64,) int8.

        The similarity of two views is the product of their VLAD descriptors.
        """
        features = descriptors.astype(np.float32)
        nearest = self.assign_words(features)
        sums = np.zeros(self.cluster_centers.shape, np.float32)
        np.add.at(sums, nearest, features - self.cluster_centers[nearest])
        normalized = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1.0)
        scaled = normalized.ravel() * (
            DESCRIPTOR_NORM / max(float(np.linalg.norm(normalized)), 1e-9)
        )
        descriptor: NDArray[np.int8] = np.clip(np.rint(scaled), -127, 127).astype(np.int8)
        return descriptor

    def assign_words(self, features: NDArray[np.float32]) -> NDArray[np.intp]:
        """(N,) index of the nearest word of each feature (N, 64)."""
        half_squares = 0.5 * np.einsum("kd,kd->k", self.cluster_centers, self.cluster_centers)
        similarity: NDArray[np.float32] = features @ self.cluster_centers.T - half_squares
        return np.asarray(similarity.argmax(axis=1), np.intp)
