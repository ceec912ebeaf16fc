"""The views of motions that need a certain scene."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, transform_points
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.motion.factory import make_motion
from drivers.synthetic.renderer import make_renderer, pixel_rays
from drivers.synthetic.room import ROOM_HEIGHT_M

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


def test_over_the_floor_only_the_floor_is_seen_except_when_it_looks_up(
    ideal: SyntheticConfig,
) -> None:
    config = replace(ideal, motion=MotionKind.FLOOR, duration_s=20.0, rate_hz=0.6)
    floor = np.mean(np.abs(heights_m(config)) < 0.01, axis=1)
    assert np.mean(floor > 0.999) >= 0.6  # at least 7 of 12
    assert 0.3 < floor.min() < 0.95


def test_an_orbit_has_something_in_its_middle_and_room_to_walk(ideal: SyntheticConfig) -> None:
    config = replace(ideal, motion=MotionKind.ORBIT, duration_s=20.0, rate_hz=0.25)
    renderer = make_renderer(config, 2)
    middle = renderer.render(0).depth_raw[40:70, 50:78] / config.depth_factor
    assert 0.8 < np.median(middle) < 2.2
    frames = [renderer.render(index) for index in range(config.frame_count)]
    assert min(frame.depth_raw.min() for frame in frames) > 0.2 * config.depth_factor
