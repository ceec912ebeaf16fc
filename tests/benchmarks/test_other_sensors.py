"""Recordings as other sensors would have them."""

import numpy as np
import pytest

from benchmarks.other_sensors import make_other_sensors, show_robot
from drivers.core.geometry import rigid_transform
from tests.vo_service.odometry.synthetic_views import render_corner


@pytest.mark.parametrize(("name", "factor"), [("half the size", 0.5), ("twice the size", 2.0)])
def test_another_size_has_the_same_rays(name: str, factor: float) -> None:
    frame = render_corner(np.eye(4))
    other = make_other_sensors()[name](frame)
    assert other.depth_raw.shape == other.color_bgr.shape[:2]
    assert other.camera.width == factor * frame.camera.width
    step = max(1, round(1 / factor))
    ray = (np.arange(0, frame.camera.width, step) - frame.camera.cx) / frame.camera.fx
    u = factor * np.arange(0, frame.camera.width, step) + (0.5 if factor > 1 else 0.0)
    np.testing.assert_allclose((u - other.camera.cx) / other.camera.fx, ray, atol=1e-9)


def test_the_noise_of_another_sensor_has_the_size_of_its_name() -> None:
    frame = render_corner(np.eye(4))
    other = make_other_sensors()["noise 0.006 1/m, 6 px"](frame)
    noise = 1.0 / other.depth_m - 1.0 / frame.depth_m
    assert noise.std() == pytest.approx(0.006, rel=0.05)
    assert np.corrcoef(noise[:, :-3].ravel(), noise[:, 3:].ravel())[0, 1] > 0.8


def test_a_sensor_of_a_small_area_or_a_short_range_has_depth_there_only() -> None:
    frame = render_corner(np.eye(4))
    middle = make_other_sensors()["depth in the middle only"](frame).depth_raw
    assert np.count_nonzero(middle) == pytest.approx(np.count_nonzero(frame.depth_raw) / 9, rel=0.2)
    assert (
        make_other_sensors()["depth up to 1.5 m"](frame).depth_m.max() <= 1.5 < frame.depth_m.max()
    )


def test_a_robot_in_view_looks_the_same_in_all_frames() -> None:
    T_aside = rigid_transform(np.eye(3), [0.3, 0.0, 0.0])
    one, other = (show_robot(render_corner(T)) for T in (np.eye(4), T_aside))
    is_robot = one.depth_m < 0.6
    assert 0.08 < is_robot.mean() < 0.16
    np.testing.assert_array_equal(one.depth_raw[is_robot], other.depth_raw[is_robot])
    np.testing.assert_array_equal(one.color_bgr[is_robot], other.color_bgr[is_robot])
