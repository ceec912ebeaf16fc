"""The motions that are hard for odometry."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.core.geometry import Array, rotation_angle_rad
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.motions import CREEP_SPEED_M_S, make_motion
from drivers.synthetic.renderer import make_renderer
from tests.drivers.synthetic.conftest import IDEAL

CONFIG = SyntheticConfig(duration_s=20.0)
TIMES_S = np.linspace(0.0, 20.0, 2001)


def poses(motion: MotionKind) -> Array:
    return make_motion(replace(CONFIG, motion=motion), 2.7).poses(TIMES_S)


def test_it_faces_the_wall_for_a_third_of_the_time_and_starts_and_ends_beside_it() -> None:
    T = poses(MotionKind.WALL)
    aside_rad = np.arctan2(-T[:, 0, 2], T[:, 1, 2])
    assert 0.3 < np.mean(np.abs(aside_rad) < 0.25) < 0.45
    assert min(aside_rad[0], aside_rad[1000], aside_rad[-1]) > 0.9
    assert T[:, 1, 3].min() > 0.3


@pytest.mark.slow
def test_before_the_bare_wall_there_is_depth_but_no_texture() -> None:
    config = replace(IDEAL, motion=MotionKind.WALL, bare_wall=True, duration_s=10.0, rate_hz=1.0)
    renderer = make_renderer(config, 2)
    aside, wall = renderer.render(0), renderer.render(5)
    edges = [cv2.Canny(frame.color_bgr, 60, 120).mean() for frame in (aside, wall)]
    assert edges[1] == 0 < edges[0]
    distance_m = wall.depth_raw / config.depth_factor
    assert 1.2 < distance_m.min() < distance_m.max() < 3.0


def test_fast_turns_take_half_a_second_at_two_to_four_radians_a_second() -> None:
    T = poses(MotionKind.FAST_TURN)
    steps = np.linalg.solve(T[:-1], T[1:])
    rates = np.array([100.0 * rotation_angle_rad(step[:3, :3]) for step in steps])
    assert 3.3 < rates.max() < 4.3
    begins = np.flatnonzero(np.diff((rates > 1.5).astype(int)) == 1)
    assert len(begins) == 6  # three pairs in twenty seconds
    fast_s = np.count_nonzero(rates > 1.5) / 100.0 / len(begins)
    assert 0.2 < fast_s < 0.5


@pytest.mark.parametrize("seed", [1, 2])
def test_a_creep_goes_straight_on_at_a_millimeter_a_second(seed: int) -> None:
    path = make_motion(replace(CONFIG, motion=MotionKind.CREEP, seed=seed), 2.7)
    T = path.poses(TIMES_S)
    steps_m = np.diff(T[:, :3, 3], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps_m, axis=1), 0.01 * CREEP_SPEED_M_S, rtol=1e-6)
    np.testing.assert_allclose(steps_m, steps_m[:1].repeat(2000, axis=0), atol=1e-12)
    np.testing.assert_array_equal(T[0, :3, :3], T[-1, :3, :3])
