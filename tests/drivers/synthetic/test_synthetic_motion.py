from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from drivers.geometry import (
    Array,
    inverse,
    is_rigid,
    rigid_transform,
    rotation_angle_rad,
    rotation_from_vector,
)
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.motion import make_path
from drivers.synthetic.spline import CubicSpline
from drivers.trajectory import pose_line

CONFIG = SyntheticConfig(duration_s=10.0)
TIMES = np.linspace(0.0, 10.0, 2001)


def track_poses(times_s: Array) -> Array:
    """A track that turns right round, so that its quaternions change sign."""
    poses = [
        rigid_transform(
            rotation_from_vector([0.1, 0.2, 0.0]) @ rotation_from_vector([0, 0, 0.7 * t]),
            (5 + np.sin(t), np.cos(0.7 * t), 1.2 + 0.1 * t),
        )
        for t in times_s
    ]
    return np.array(poses)


@pytest.fixture
def track(tmp_path: Path) -> Path:
    file, times_s = tmp_path / "track.txt", np.arange(0.0, 12.0, 0.01)
    lines = [pose_line(100 + t, T) for t, T in zip(times_s, track_poses(times_s), strict=True)]
    file.write_text("# a track\n" + "".join(lines))
    return file


@pytest.mark.parametrize("motion", list(Motion))
def test_built_in_motions_are_rigid_and_end_where_they_began(motion: Motion) -> None:
    poses = make_path(replace(CONFIG, motion=motion), 2.7).poses(TIMES)
    assert all(is_rigid(T, 1e-9) for T in poses[::100])
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-9)


@pytest.mark.parametrize("motion", [Motion.HAND_HELD, Motion.SMOOTH])
def test_motion_is_continuous_to_the_acceleration(motion: Motion) -> None:
    position_m = make_path(replace(CONFIG, motion=motion), 2.7).poses(TIMES)[:, :3, 3]
    acceleration = np.diff(position_m, n=2, axis=0) / 0.005**2
    assert np.abs(acceleration).max() < 10.0
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.5


def test_a_hand_trembles_about_the_smooth_path_and_still_is_still() -> None:
    hand, smooth, still = (
        make_path(replace(CONFIG, motion=motion), 2.7).poses(TIMES)
        for motion in (Motion.HAND_HELD, Motion.SMOOTH, Motion.STILL)
    )
    apart_m = np.linalg.norm(hand[:, :3, 3] - smooth[:, :3, 3], axis=1)
    assert 0.003 < apart_m.max() < 0.05
    angles = [rotation_angle_rad(inverse(a)[:3, :3] @ b[:3, :3]) for a, b in zip(hand, smooth)]  # noqa: B905
    assert 0.005 < max(angles) < 0.08
    np.testing.assert_array_equal(still[0], still[-1])


def test_another_seed_moves_otherwise() -> None:
    a, b = (make_path(replace(CONFIG, seed=seed), 2.7).poses(TIMES[:5]) for seed in (1, 2))
    assert np.abs(a - b).max() > 0.01


def test_a_track_keeps_its_shape_and_its_rotations_in_the_middle_of_the_room(track: Path) -> None:
    config = replace(CONFIG, track=track, track_start_s=1.0)
    times_s = np.linspace(0.0, 10.0, 333)
    poses, true = make_path(config, 2.7).poses(times_s), track_poses(times_s + 1.0)
    shift = poses[:, :3, 3] - true[:, :3, 3]
    np.testing.assert_allclose(shift, shift[:1].repeat(333, axis=0), atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], true[:, :3, :3], atol=1e-6)
    low, high = poses[:, :3, 3].min(axis=0), poses[:, :3, 3].max(axis=0)
    np.testing.assert_allclose((low + high)[:2], 0.0, atol=0.01)
    assert 0.3 < low[2] < high[2] < 2.4


def test_a_looped_track_goes_there_and_back(track: Path) -> None:
    poses = make_path(replace(CONFIG, track=track, loop=True), 2.7).poses(TIMES)
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-9)
    np.testing.assert_allclose(poses[400], poses[-401], atol=1e-9)
    assert np.abs(poses[1000] - poses[0]).max() > 0.5


def test_a_track_that_is_too_short_says_how_long_it_is(track: Path) -> None:
    with pytest.raises(InputError, match=r"track.txt: holds 11.990 s .* duration_s is 20"):
        make_path(replace(CONFIG, track=track, duration_s=20.0), 2.7)


def test_a_spline_follows_a_smooth_curve_between_its_knots() -> None:
    knots = np.linspace(0.0, 6.0, 61)
    spline = CubicSpline(knots, np.stack([np.sin(knots), np.cos(knots)], axis=1))
    at = np.linspace(1.0, 5.0, 777)
    expected = np.stack([np.sin(at), np.cos(at)], axis=1)
    np.testing.assert_allclose(spline(at), expected, atol=1e-5)
    np.testing.assert_allclose(spline(knots)[:, 0], np.sin(knots), atol=1e-12)


def test_a_natural_spline_through_three_points_is_the_one_worked_by_hand() -> None:
    """Knots 0 1 2, values 0 1 0: second derivative -3 in the middle, 11/16 at 0.5."""
    spline = CubicSpline(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [0.0]]))
    assert spline(np.array([0.5]))[0, 0] == pytest.approx(11 / 16)
