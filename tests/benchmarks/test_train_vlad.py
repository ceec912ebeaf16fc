from pathlib import Path

import numpy as np

from benchmarks.train_vlad import extract_descriptors, fit_centers


def test_visual_words_are_cluster_centers_and_repeatable() -> None:
    random = np.random.default_rng(1)
    centers = random.integers(-60, 60, (4, 64)).astype(np.float32)
    descriptors = np.repeat(centers, 50, axis=0) + random.integers(-1, 2, (200, 64))
    words = fit_centers(descriptors.astype(np.float32), 4)
    by_order = centers[np.lexsort(centers.T[::-1])]
    assert words.dtype == np.int8
    assert np.abs(words - by_order).max() <= 1.0
    assert np.array_equal(words, fit_centers(descriptors.astype(np.float32), 4))


def test_a_recording_is_described_every_thirtieth_frame(recording: Path) -> None:
    descriptors = list(extract_descriptors(recording))
    assert len(descriptors) == 1
    assert descriptors[0].shape[1] == 64
