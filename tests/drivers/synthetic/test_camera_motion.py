"""Camera motions: they are smooth, loop, and show what they are for."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError
from drivers.core.geometry import (
    Array,
    format_pose_line,
    inverse,
    is_rigid,
    rigid_transform,
    rotation_angle_rad,
    so3_exp,
    transform_points,
)
from drivers.synthetic.camera_motion import CubicSpline
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import make_renderer, pixel_rays
from drivers.synthetic.room import ROOM_HEIGHT_M
from tests.drivers.synthetic.conftest import IDEAL

CONFIG = SyntheticConfig(duration_s=10.0)
TIMES = np.linspace(0.0, 10.0, 2001)


def track_poses(times_s: Array) -> Array:
    """A track with a full turn, so that its quaternions change sign."""
    poses = [
        rigid_transform(
            so3_exp([0.1, 0.2, 0.0]) @ so3_exp([0, 0, 0.7 * t]),
            (5 + np.sin(t), np.cos(0.7 * t), 1.2 + 0.1 * t),
        )
        for t in times_s
    ]
    return np.array(poses)


# A base that nobody drives stands still.
AT_REST = (MotionKind.STILL, MotionKind.DRIVEN)


@pytest.fixture
def track(tmp_path: Path) -> Path:
    file, times_s = tmp_path / "track.txt", np.arange(0.0, 12.0, 0.01)
    lines = [
        format_pose_line(100 + t, T) for t, T in zip(times_s, track_poses(times_s), strict=True)
    ]
    file.write_text("# a track\n" + "".join(lines))
    return file


@pytest.mark.parametrize("motion", list(MotionKind))
def test_built_in_motions_are_rigid_and_end_where_they_began(motion: MotionKind) -> None:
    poses = make_motion(replace(CONFIG, motion=motion, loop=True), 2.7).poses(TIMES)
    assert all(is_rigid(T, 1e-9) for T in poses[::100])
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-9)


@pytest.mark.parametrize("motion", [motion for motion in MotionKind if motion not in AT_REST])
def test_motion_is_continuous_to_the_acceleration(motion: MotionKind) -> None:
    position_m = make_motion(replace(CONFIG, motion=motion), 2.7).poses(TIMES)[:, :3, 3]
    acceleration = np.diff(position_m, n=2, axis=0) / 0.005**2
    assert np.abs(acceleration).max() < 10.0
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.5


def test_a_hand_trembles_about_the_smooth_path_and_still_is_still() -> None:
    hand, smooth, still = (
        make_motion(replace(CONFIG, motion=motion), 2.7).poses(TIMES)
        for motion in (MotionKind.HAND_HELD, MotionKind.SMOOTH, MotionKind.STILL)
    )
    apart_m = np.linalg.norm(hand[:, :3, 3] - smooth[:, :3, 3], axis=1)
    assert 0.003 < apart_m.max() < 0.05
    angles = [rotation_angle_rad(inverse(a)[:3, :3] @ b[:3, :3]) for a, b in zip(hand, smooth)]  # noqa: B905
    assert 0.005 < max(angles) < 0.08
    np.testing.assert_array_equal(still[0], still[-1])


@pytest.mark.parametrize("motion", [motion for motion in MotionKind if motion not in AT_REST])
def test_another_seed_gives_another_motion(motion: MotionKind) -> None:
    config = replace(CONFIG, motion=motion)
    a, b = (make_motion(replace(config, seed=seed), 2.7).poses(TIMES[:5]) for seed in (1, 2))
    assert np.abs(a - b).max() > 0.01


def downward_rad(poses: Array) -> Array:
    """Angle of each view's center below the horizon."""
    return np.arcsin(-poses[:, 2, 2])


def test_over_the_floor_it_looks_down_except_for_a_short_look_up_every_ten_seconds() -> None:
    config = replace(CONFIG, motion=MotionKind.FLOOR, duration_s=20.0)
    path = make_motion(config, 2.7)
    poses = path.poses(np.linspace(0.0, 20.0, 2001))
    up = downward_rad(poses) < 0.85
    assert 0.03 < up.mean() < 0.25
    assert np.count_nonzero(np.diff(up.astype(int)) == 1) == 2
    assert 0.9 < poses[:, 2, 3].min() < poses[:, 2, 3].max() < 1.4


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_clearance_points_reach_down_to_the_visible_floor(seed: int) -> None:
    config = replace(CONFIG, motion=MotionKind.FLOOR, seed=seed)
    path = make_motion(config, 2.7)
    first = np.array([0.0])  # looking down
    points, T = path.clearance_points_m(first), path.poses(first)[0]
    on_floor = points[np.abs(points[:, 2]) < 1e-9]
    seen = transform_points(inverse(T), on_floor)
    assert np.all(seen[:, 2] > 0)
    edge = np.abs(seen[:, :2] / seen[:, 2:]).max(axis=0)
    assert np.all(edge >= (319.5 / 525, 239.5 / 525))


def test_an_orbit_goes_all_the_way_round_and_mostly_looks_at_the_middle() -> None:
    config = replace(CONFIG, motion=MotionKind.ORBIT, duration_s=20.0)
    poses = make_motion(config, 2.7).poses(np.linspace(0.0, 20.0, 2001))
    x, y = poses[:, 0, 3], poses[:, 1, 3]
    assert np.ptp(np.unwrap(np.arctan2(y, x))) == pytest.approx(2 * np.pi, abs=0.02)
    assert 1.4 < np.hypot(x, y).min() < np.hypot(x, y).max() < 2.1
    ahead = -(x * poses[:, 0, 2] + y * poses[:, 1, 2])
    aside = np.abs(np.arctan2(x * poses[:, 1, 2] - y * poses[:, 0, 2], ahead))
    assert np.median(aside) < 0.2 < 0.35 < aside.max()


@pytest.mark.usefixtures("unpainted")
def test_an_orbit_has_fast_turns_but_no_faster_than_a_hand() -> None:
    config = replace(CONFIG, motion=MotionKind.ORBIT, duration_s=20.0)
    poses = make_motion(config, 2.7).poses(np.arange(600) / 30.0)
    steps = [inverse(a)[:3, :3] @ b[:3, :3] for a, b in pairwise(poses)]
    rates = np.degrees([30.0 * rotation_angle_rad(step) for step in steps])
    assert 20.0 < np.median(rates) < 40.0
    assert 50.0 < rates.max() < 90.0


@pytest.mark.parametrize("motion", [MotionKind.FLOOR, MotionKind.ORBIT, MotionKind.TOUR])
@pytest.mark.parametrize("duration_s", [0.2, 3.0, 7.0])
def test_a_short_sequence_is_not_faster(motion: MotionKind, duration_s: float) -> None:
    config = replace(CONFIG, motion=motion, duration_s=duration_s)
    times_s = np.linspace(0.0, duration_s, 101)
    position_m = make_motion(config, 2.7).poses(times_s)[:, :3, 3]
    speed = np.linalg.norm(np.diff(position_m, axis=0), axis=1) / np.diff(times_s)
    assert speed.max() < 1.2


def test_a_track_keeps_its_shape_and_its_rotations_in_the_middle_of_the_room(track: Path) -> None:
    config = replace(CONFIG, track=track, track_start_s=1.0)
    times_s = np.linspace(0.0, 10.0, 333)
    poses, true = make_motion(config, 2.7).poses(times_s), track_poses(times_s + 1.0)
    shift = poses[:, :3, 3] - true[:, :3, 3]
    np.testing.assert_allclose(shift, shift[:1].repeat(333, axis=0), atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], true[:, :3, :3], atol=1e-6)
    low, high = poses[:, :3, 3].min(axis=0), poses[:, :3, 3].max(axis=0)
    np.testing.assert_allclose((low + high)[:2], 0.0, atol=0.01)
    assert 0.3 < low[2] < high[2] < 2.4


def test_a_looped_track_goes_there_and_back(track: Path) -> None:
    poses = make_motion(replace(CONFIG, track=track, loop=True), 2.7).poses(TIMES)
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-9)
    np.testing.assert_allclose(poses[400], poses[-401], atol=1e-9)
    assert np.abs(poses[1000] - poses[0]).max() > 0.5


def test_a_track_that_is_too_short_says_how_long_it_is(track: Path) -> None:
    with pytest.raises(InputError, match=r"track.txt: has 11.990 s .* duration_s is 20"):
        make_motion(replace(CONFIG, track=track, duration_s=20.0), 2.7)


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


pytestmark = pytest.mark.slow


def heights_m(config: SyntheticConfig) -> Array:
    """Height above the floor of each pixel's point, by frame (N, H * W)."""
    renderer = make_renderer(config, 2)
    rays = pixel_rays(config.camera, np.zeros(5)).reshape(-1, 2)
    times_s = np.arange(config.frame_count) / config.rate_hz
    heights = []
    for index, T_world_camera in enumerate(make_motion(config, ROOM_HEIGHT_M).poses(times_s)):
        z = renderer.render(index).depth_raw.reshape(-1, 1) / config.depth_factor
        heights.append(transform_points(T_world_camera, np.hstack([rays * z, z]))[:, 2])
    return np.array(heights)


@pytest.mark.usefixtures("unpainted")
def test_over_the_floor_only_the_floor_is_seen_except_when_it_looks_up() -> None:
    config = replace(IDEAL, motion=MotionKind.FLOOR, duration_s=20.0, rate_hz=0.6)
    floor = np.mean(np.abs(heights_m(config)) < 0.01, axis=1)
    assert np.mean(floor > 0.999) >= 0.6  # at least 7 of 12
    assert 0.3 < floor.min() < 0.95


@pytest.mark.usefixtures("unpainted")
def test_an_orbit_has_something_in_its_middle_and_room_to_walk() -> None:
    config = replace(IDEAL, motion=MotionKind.ORBIT, duration_s=20.0, rate_hz=0.25)
    renderer = make_renderer(config, 2)
    middle = renderer.render(0).depth_raw[40:70, 50:78] / config.depth_factor
    assert 0.8 < np.median(middle) < 2.2
    frames = [renderer.render(index) for index in range(config.frame_count)]
    assert min(frame.depth_raw.min() for frame in frames) > 0.2 * config.depth_factor
