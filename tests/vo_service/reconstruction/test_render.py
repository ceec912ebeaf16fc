"""Rendered images show the nearest surface, in its color, at the right pixels."""

import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.core.geometry import rigid_transform, so3_exp
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.render import (
    BACKGROUND,
    OrthographicView,
    render_orthographic,
    render_perspective,
)

CAMERA = PinholeCamera(40, 30, 40.0, 40.0, 19.5, 14.5)
GREEN, RED = (0, 200, 0), (200, 0, 0)


def square(half_m: float, z: float, color: tuple[int, int, int], x: float = 0.0) -> Mesh:
    """Make a square across the z axis that faces towards smaller z."""
    corners = [[x - half_m, -half_m, z], [x + half_m, -half_m, z]]
    corners += [[x + half_m, half_m, z], [x - half_m, half_m, z]]
    return Mesh(
        np.array(corners, np.float32),
        np.tile(np.array([0, 0, -1], np.float32), (4, 1)),
        np.tile(np.array(color, np.uint8), (4, 1)),
        np.array([[0, 2, 1], [0, 3, 2]], np.int32),
    )


def both(first: Mesh, second: Mesh) -> Mesh:
    return Mesh(
        np.vstack([first.vertices_m, second.vertices_m]),
        np.vstack([first.normals, second.normals]),
        np.vstack([first.colors_rgb, second.colors_rgb]),
        np.vstack([first.triangles, second.triangles + 4]).astype(np.int32),
    )


def columns_of(image: np.ndarray, color: tuple[int, int, int]) -> list[int]:
    """Return the columns of the middle row that nearly have this color."""
    near = np.all(np.abs(image[15].astype(int) - color) < 45, axis=1)
    return [int(column) for column in np.flatnonzero(near)]


@pytest.mark.slow
def test_a_square_covers_the_pixels_that_it_projects_to() -> None:
    image = render_perspective(square(0.5, 2.0, GREEN), CAMERA, np.eye(4))
    # Half a meter at 2 m with 40 pixels of focal length: 10 pixels each way of column 19.5.
    assert columns_of(image, GREEN) == list(range(10, 30))
    assert np.all(image[:4] == BACKGROUND)


def test_the_nearer_triangle_occludes_the_further_in_any_order() -> None:
    near, far = square(0.25, 1.0, RED, x=0.25), square(0.5, 2.0, GREEN)
    for mesh in (both(near, far), both(far, near)):
        image = render_perspective(mesh, CAMERA, np.eye(4))
        assert columns_of(image, RED) == list(range(20, 40))
        assert columns_of(image, GREEN) == list(range(10, 20))


def test_triangles_from_behind_or_behind_the_camera_are_not_drawn() -> None:
    T_camera_world = rigid_transform(so3_exp([0, np.pi, 0]), [0, 0, 4.0])
    assert np.all(render_perspective(square(0.5, 2.0, RED), CAMERA, T_camera_world) == BACKGROUND)
    assert np.all(render_perspective(square(0.5, -2.0, RED), CAMERA, np.eye(4)) == BACKGROUND)


def test_oblique_surfaces_are_darker() -> None:
    tilted = rigid_transform(so3_exp([0.9, 0, 0]), [0, 0, 2.0])
    straight = rigid_transform(np.eye(3), [0, 0, 2.0])
    bright, dark = (
        render_perspective(square(0.5, 0.0, GREEN), CAMERA, T)[15, 20, 1]
        for T in (straight, tilted)
    )
    assert 0.4 * bright < dark < 0.9 * bright


def test_an_orthographic_view_has_no_perspective() -> None:
    near_and_far = both(square(0.5, 1.0, RED, x=-0.6), square(0.5, 9.0, GREEN, x=0.6))
    view = OrthographicView(np.eye(4), (-1.45, -0.75), 0.1, 30, 16)
    image = render_orthographic(near_and_far, view)
    # Columns 0.1 m wide, the first about -1.45 m: -1.1 to -0.1 m, and 0.1 to 1.1 m.
    row = image[7]
    assert [int(c) for c in np.flatnonzero(np.all(row == RED, axis=1))] == list(range(4, 14))
    assert [int(c) for c in np.flatnonzero(np.all(row == GREEN, axis=1))] == list(range(16, 26))


def test_an_image_of_nothing_is_background() -> None:
    assert np.all(render_perspective(Mesh.empty(), CAMERA, np.eye(4)) == BACKGROUND)
