"""Views of place recognition, and its trained words."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.place_recognition import (
    VIEW_OFFSETS,
    extract_descriptors,
    fit_centers,
    poses_around,
    views_of_recording,
)
from benchmarks.rendered_sequences import GivenPoses
from drivers.core import InputError
from drivers.core.geometry import inverse, rigid_transform, rotation_angle_rad


def test_views_around_a_spot_have_the_configured_offsets() -> None:
    spot, *others = poses_around(
        rigid_transform(np.eye(3), [1.0, 2.0, 3.0]), np.random.default_rng(1)
    )
    for T, (distance_m, degrees) in zip(others, VIEW_OFFSETS, strict=True):
        step = inverse(spot) @ T
        assert np.linalg.norm(step[:3, 3]) == pytest.approx(distance_m)
        assert np.degrees(rotation_angle_rad(step[:3, :3])) == pytest.approx(degrees)


def test_a_camera_moves_during_each_view() -> None:
    poses = np.array([rigid_transform(np.eye(3), [x, 0.0, 0.0]) for x in (0.0, 5.0)])
    path = GivenPoses(poses, 30.0, np.array([[0.3, 0, 0, 0, 0, 0], np.zeros(6)]))
    x_m = path.poses(np.array([-0.01, 0.0, 0.01, 1 / 30, 1 / 30 + 0.01]))[:, 0, 3]
    assert x_m == pytest.approx([-0.003, 0.0, 0.003, 5.0, 5.0])


def test_views_of_a_recording_have_the_velocity_of_its_truth(recording: Path) -> None:
    (glance,) = views_of_recording(recording)
    assert np.linalg.norm(glance.velocity[:3]) > 0.0
    assert np.isfinite(glance.T_world_camera).all()


def test_a_recording_without_truth_is_rejected(recording: Path, tmp_path: Path) -> None:
    for each in recording.iterdir():
        if each.name != "groundtruth.txt":
            (tmp_path / each.name).symlink_to(each)
    with pytest.raises(InputError, match="name a recording with one"):
        next(views_of_recording(tmp_path))


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
