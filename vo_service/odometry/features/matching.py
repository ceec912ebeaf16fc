"""Matching of features by the nearest descriptor, with a ratio test and a mutual check."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel


class HasDescriptors(Protocol):
    """Features that can be matched.

    Attributes:
        sign: (N,) of the Laplacian: +1 dark blob, -1 bright blob.
        descriptor: (N, 64) float32 whole numbers.
    """

    @property
    def sign(self) -> NDArray[np.generic]: ...

    @property
    def descriptor(self) -> NDArray[np.float32]: ...


def match_features(
    query: HasDescriptors, reference: HasDescriptors, ratio: float
) -> NDArray[np.int64]:
    """Match features: pairs (M, 2) of indices into `query` and `reference`, sorted by query.

    A pair needs a second nearest descriptor further by 1/ratio (Lowe 2004, Section 7.1), and each
    has to be the other's nearest. Bright and dark blobs are never compared (Bay et al. 2008,
    Section 4.3).

    Args:
        query: Features that are matched.
        reference: Features that they are matched with.
        ratio: Largest ratio of the nearest to the second nearest distance.
    """
    blocks = [np.empty((0, 2), np.int64)]
    for sign in (-1.0, 1.0):
        queries = np.flatnonzero(query.sign == sign)
        references = np.flatnonzero(reference.sign == sign)
        if len(queries) and len(references):
            pairs = match_descriptors(
                query.descriptor[queries], reference.descriptor[references], ratio
            )
            blocks.append(np.column_stack([queries[pairs[:, 0]], references[pairs[:, 1]]]))
    pairs = np.concatenate(blocks)
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def match_descriptors(
    query: NDArray[np.float32], reference: NDArray[np.float32], ratio: float
) -> NDArray[np.int64]:
    """Match descriptors: pairs (M, 2) of rows of `query` (N, D) and `reference` (K, D).

    They are float32 whole numbers: every dot product is exact with any BLAS and thread count.

    Args:
        query: (N, D) descriptors that are matched.
        reference: (K, D) descriptors that they are matched with.
        ratio: Largest ratio of the nearest to the second nearest distance.
    """
    similarity = _similarity(query, reference)
    best, second, nearest = find_best_two(similarity)
    queries = np.flatnonzero(best > ratio**2 * second.astype(np.float64))
    references = nearest[queries]
    is_mutual = similarity.argmax(axis=1)[references] == queries
    return np.column_stack([queries[is_mutual], references[is_mutual]]).astype(np.int64)


def _similarity(query: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float32]:
    """(K, N) table of -|q - r|^2 / 2 = q.r - |r|^2 / 2 - |q|^2 / 2, as one matrix product."""
    half = np.float32(0.5)
    one_q, one_r = np.ones(len(query), np.float32), np.ones(len(reference), np.float32)
    queries = np.vstack([query.T, one_q, -half * np.einsum("nd,nd->n", query, query)])
    references = np.column_stack(
        [reference, -half * np.einsum("kd,kd->k", reference, reference), one_r]
    )
    table: NDArray[np.float32] = references @ queries
    return table


@kernel
def find_best_two(
    similarity: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Per column of a (K, N) table: largest value, second largest, and row of the largest.

    Runs down all columns at once, so that it vectorizes.
    """
    rows, columns = similarity.shape
    best = np.full(columns, np.float32(-np.inf), np.float32)
    second = np.full(columns, np.float32(-np.inf), np.float32)
    nearest = np.zeros(columns, np.int32)
    for r in range(rows):
        row = similarity[r]
        for c in range(columns):
            value, largest = row[c], best[c]
            runner_up = largest if value > largest else value
            second[c] = runner_up if runner_up > second[c] else second[c]
            nearest[c] = np.int32(r) if value > largest else nearest[c]
            best[c] = value if value > largest else largest
    return best, second, nearest
