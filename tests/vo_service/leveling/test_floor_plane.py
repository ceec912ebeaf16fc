"""The floor in a depth image."""

from math import cos, radians

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, so3_exp
from tests.vo_service.leveling.floor_views import (
    CAMERA,
    NO_DEPTH,
    Depth,
    floor_depth,
    make_view,
    mount,
)
from vo_service.leveling.floor_plane import FloorDetector, FloorPlane

TILT_RAD = radians(5.0)


def find(depth_raw: Depth, up: Array) -> FloorPlane | None:
    return FloorDetector(CAMERA).find(make_view(depth_raw), up, TILT_RAD)


@given(
    height_m=st.floats(0.3, 1.2),
    down_rad=st.floats(0.3, 0.6),
    error_rad=st.tuples(*[st.floats(-0.015, 0.015)] * 3),
)
def test_the_floor_is_found_though_up_is_known_to_a_degree_only(
    height_m: float, down_rad: float, error_rad: tuple[float, float, float]
) -> None:
    up = mount(height_m, down_rad)[2, :3]
    floor = find(floor_depth(up, height_m, noise_per_m=3e-3), so3_exp(error_rad) @ up)
    assert floor is not None
    assert floor.up @ up > cos(radians(0.2))
    np.testing.assert_allclose(floor.height_m, height_m, atol=0.01)


def test_a_table_in_front_of_the_floor_is_not_taken_for_it() -> None:
    up = mount(1.2, 0.5)[2, :3]
    depth_raw, table = floor_depth(up, 1.2), floor_depth(up, 0.5)
    depth_raw[:, :160] = table[:, :160]
    floor = find(depth_raw, up)
    assert floor is not None
    np.testing.assert_allclose(floor.height_m, 1.2, atol=0.01)


def test_a_view_without_depth_or_with_a_wall_only_has_no_floor() -> None:
    up = mount(0.5)[2, :3]
    assert find(NO_DEPTH, up) is None
    assert find(np.full_like(NO_DEPTH, 15000), up) is None


def test_a_plane_that_is_too_steep_is_no_floor() -> None:
    up = mount(0.5)[2, :3]
    ramp = floor_depth(so3_exp([radians(12.0), 0.0, 0.0]) @ up, 0.5)
    assert find(ramp, up) is None


def test_a_step_too_short_to_tell_its_slope_is_no_floor() -> None:
    up = mount(0.5)[2, :3]
    depth_raw = floor_depth(up, 0.5)
    depth_raw[(depth_raw < 11000) | (depth_raw > 18000)] = 0
    assert find(depth_raw, up) is None
