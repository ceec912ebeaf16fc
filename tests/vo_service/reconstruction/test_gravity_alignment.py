"""The up direction comes from gravity or the camera's axes, then from the floor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, rigid_transform, so3_exp, transform_points
from vo_service.reconstruction.gravity_alignment import (
    UpDirectionEstimator,
    estimate_up,
    level_transform,
)
from vo_service.reconstruction.mesh import Mesh

UP = np.array([0.2, -0.9, 0.38])
UP = UP / np.linalg.norm(UP)
ANGLES = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


def facing(*normals: Array) -> Mesh:
    """Make a mesh with 50 vertices of each normal."""
    every = np.repeat(np.array(normals, np.float32), 50, axis=0)
    nothing = Mesh.empty()
    return Mesh(every, every, np.zeros((len(every), 3), np.uint8), nothing.triangles)


def test_gravity_takes_precedence_over_the_camera_orientation() -> None:
    estimator = UpDirectionEstimator()
    R = so3_exp([0.4, -0.2, 0.3])
    gravity = R.T @ (-9.81 * UP)
    estimator.add(rigid_transform(R, [1, 2, 3]), (gravity[0], gravity[1], gravity[2]))
    estimator.add(np.eye(4), None)
    np.testing.assert_allclose(estimator.up, UP, atol=1e-12)


def test_without_gravity_up_is_the_mean_of_the_camera_tops() -> None:
    estimator = UpDirectionEstimator()
    for roll in (-0.5, 0.5):
        estimator.add(rigid_transform(so3_exp([0, 0, roll]), [0, 0, 0]), None)
    np.testing.assert_allclose(estimator.up, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(UpDirectionEstimator().up, [0, -1, 0])


def test_the_floor_corrects_a_guess_with_an_error_of_twenty_degrees() -> None:
    tilted_up = so3_exp([np.radians(20), 0, 0]) @ UP
    wall = np.cross(UP, [1.0, 0, 0])
    mesh = facing(UP, UP, -UP, wall, -wall)
    np.testing.assert_allclose(estimate_up(mesh, tilted_up), UP, atol=1e-6)


@pytest.mark.parametrize("mesh", [Mesh.empty(), facing(np.array([1.0, 0, 0]))])
def test_without_a_floor_the_guess_is_used(mesh: Mesh) -> None:
    np.testing.assert_array_equal(estimate_up(mesh, UP), UP)


@given(ANGLES, ANGLES)
def test_level_axes_are_right_handed_with_z_up_and_the_camera_at_the_origin(
    turn: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    T_world_camera = rigid_transform(so3_exp(turn), place)
    T_level_world = level_transform(T_world_camera, UP)
    R = T_level_world[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) > 0
    np.testing.assert_allclose(R @ UP, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(transform_points(T_level_world, np.array([place])), 0, atol=1e-9)


def test_forward_is_the_viewing_direction_or_the_camera_top_when_it_looks_down() -> None:
    level = level_transform(np.eye(4), np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(level[:3, :3] @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    down = level_transform(np.eye(4), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(down[:3, :3] @ [0, -1, 0], [0, 1, 0], atol=1e-12)
