"""The level frame of a camera on a base."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import T_BODY_CAMERA, Array, rigid_transform, so3_exp
from tests.vo_service.navigation.views import mounted
from vo_service.navigation.level_view import LevelMounting

angles = st.floats(-3.1, 3.1)
tilts = st.floats(-0.5, 0.5)
lengths = st.floats(-2.0, 2.0)


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Array:
    return so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.0, pitch, 0.0]) @ so3_exp([roll, 0.0, 0.0])


@given(angles, tilts, tilts, angles, tilts, tilts, lengths)
def test_a_point_is_where_the_poses_have_it(
    yaw: float, pitch: float, roll: float, turn: float, nod: float, lean: float, x: float
) -> None:
    """Of any camera on any tilted base: same height, and same place once the base is level."""
    T_base_camera = rigid_transform(turned(turn, nod, lean), (x, 0.3, 0.7)) @ T_BODY_CAMERA
    T_odom_base = rigid_transform(turned(yaw, pitch, roll), (3.0, -2.0, 0.0))
    mounting = LevelMounting(T_base_camera)
    view = mounting.view(T_odom_base @ T_base_camera)
    point = np.array([0.2, -0.4, 2.0])
    in_odom = (T_odom_base @ T_base_camera @ [*point, 1.0])[:3]
    in_level = view.R_level_camera @ point
    assert in_level[2] + view.height_m == pytest.approx(in_odom[2], abs=1e-9)
    pose = mounting.planar_pose(T_odom_base @ T_base_camera)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    placed = pose[:2] + np.array([[c, -s], [s, c]]) @ in_level[:2]
    np.testing.assert_allclose(placed, in_odom[:2], atol=1e-9)


@given(angles, tilts, lengths)
def test_the_static_frame_of_a_level_base_is_the_level_frame(
    turn: float, nod: float, x: float
) -> None:
    T_base_camera = rigid_transform(turned(turn, nod), (x, 0.3, 0.7)) @ T_BODY_CAMERA
    mounting = LevelMounting(T_base_camera)
    point = np.array([0.2, -0.4, 2.0])
    in_level = mounting.view(T_base_camera).R_level_camera @ point
    in_base = (mounting.T_base_level(0.2) @ [in_level[0], in_level[1], 0.0, 1.0])[:3]
    np.testing.assert_allclose(in_base[:2], (T_base_camera @ [*point, 1.0])[:2], atol=1e-9)
    assert in_base[2] == pytest.approx(0.2)
    # The camera looks along x of its level frame.
    forward = mounting.view(T_base_camera).R_level_camera[:, 2]
    assert forward[0] > 0
    assert forward[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("down_deg", [90.0, -90.0])
def test_a_camera_that_looks_straight_down_or_up_has_a_yaw(down_deg: float) -> None:
    rotation = LevelMounting(mounted(1.0, down_deg)).T_base_level(0.0)[:3, :3]
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)
