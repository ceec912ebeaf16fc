"""The mesh is closed and consistently oriented."""

import numpy as np

from tests.vo_service.reconstruction.scenes import fuse_views, render_wall
from vo_service.reconstruction.mesh import Mesh, remove_small_components


def edges_of(mesh: Mesh) -> np.ndarray:
    t = mesh.triangles
    return np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])


def test_a_sphere_is_closed_with_every_edge_used_once_in_each_direction(exact_ball: Mesh) -> None:
    edges = edges_of(exact_ball)
    directed_edges = {tuple(edge) for edge in edges.tolist()}
    assert len(directed_edges) == len(edges)
    assert {(b, a) for a, b in directed_edges} == directed_edges
    # A sphere by Euler: V - E + F = 2.
    assert len(exact_ball.vertices_m) - len(edges) // 2 + len(exact_ball.triangles) == 2


def test_triangles_are_oriented_like_their_normals(exact_ball: Mesh) -> None:
    a, b, c = (exact_ball.vertices_m[exact_ball.triangles[:, corner]] for corner in range(3))
    triangle_normals = np.cross(b - a, c - a)
    mean = exact_ball.normals[exact_ball.triangles].mean(axis=1)
    assert np.min(np.sum(triangle_normals * mean, axis=1)) > 0


def test_normals_have_length_one(exact_ball: Mesh) -> None:
    np.testing.assert_allclose(np.linalg.norm(exact_ball.normals, axis=1), 1.0, atol=1e-6)


def test_a_wall_has_no_hole_between_blocks() -> None:
    mesh = fuse_views(render_wall(2.0)).extract_mesh()
    edges = np.sort(edges_of(mesh), axis=1)
    ends, counts = np.unique(edges, axis=0, return_counts=True)
    rim = mesh.vertices_m[ends[counts == 1]].mean(axis=1)
    # Edges that only one triangle has lie along the rim of what was seen: 2 m x 52 pixels.
    x, y = np.abs(rim[:, 0]) / (2.0 * 32 / 52), np.abs(rim[:, 1]) / (2.0 * 24 / 52)
    assert np.all(np.maximum(x, y) > 0.9)


def merge(*parts: Mesh) -> Mesh:
    firsts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    shifted = [part.triangles + first for part, first in zip(parts, firsts, strict=False)]
    return Mesh(
        np.concatenate([part.vertices_m for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.colors_rgb for part in parts]),
        np.concatenate(shifted).astype(np.int32),
    )


def small_component(triangles: int) -> Mesh:
    """Make a strip of this many triangles."""
    count = triangles + 2
    corners = np.array([[k // 2, k % 2, 5] for k in range(count)], np.float32)
    strip = np.array([[k, k + 1, k + 2] for k in range(triangles)], np.int32)
    normals = np.tile(np.array([0, 0, -1], np.float32), (count, 1))
    return Mesh(corners, normals, np.full((count, 3), 7, np.uint8), strip)


def test_small_components_are_removed_and_the_rest_is_unchanged(exact_ball: Mesh) -> None:
    cleaned = remove_small_components(merge(small_component(9), exact_ball, small_component(5)), 10)
    np.testing.assert_array_equal(cleaned.vertices_m, exact_ball.vertices_m)
    np.testing.assert_array_equal(cleaned.colors_rgb, exact_ball.colors_rgb)
    np.testing.assert_array_equal(cleaned.triangles, exact_ball.triangles)


def test_a_component_of_the_minimum_size_is_kept(exact_ball: Mesh) -> None:
    cleaned = remove_small_components(merge(exact_ball, small_component(10)), 10)
    assert len(cleaned.triangles) == len(exact_ball.triangles) + 10
    assert len(remove_small_components(small_component(9), 10).vertices_m) == 0
