"""Frames of known shapes become surfaces at the right position, within the memory limit."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.reconstruction.scenes import (
    BLUE,
    CAMERA,
    RED,
    SETTINGS,
    fuse_views,
    pixel_rays,
    render_ball,
    render_wall,
)
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.tsdf_volume import TsdfVolume


def assert_at(mesh: Mesh, distance_m: float, within_m: float = 1e-3) -> None:
    """Assert that a wall across the world's z axis is at this distance."""
    assert len(mesh.vertices_m) > 1000
    np.testing.assert_allclose(mesh.vertices_m[:, 2], distance_m, atol=within_m)


def test_a_wall_is_at_its_measured_place_and_faces_the_camera() -> None:
    mesh = fuse_views(render_wall(2.03), render_wall(2.03)).extract_mesh()
    assert_at(mesh, 2.03)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, -1], (len(mesh.normals), 1)), atol=1e-3)
    np.testing.assert_array_equal(np.unique(mesh.colors_rgb, axis=0), [RED[::-1]])


def test_a_wall_is_in_the_world_frame_for_any_camera_pose() -> None:
    volume = TsdfVolume(SETTINGS)
    for turn, x in ((0.0, 0.0), (0.3, -0.4), (-0.25, 0.5)):
        T_world_camera = rigid_transform(so3_exp([0.1, turn, turn]), [x, 0.1, x])
        directions = pixel_rays() @ T_world_camera[2, :3]
        depth_m = ((2.0 - T_world_camera[2, 3]) / directions).astype(np.float32)
        volume.integrate(depth_m, render_wall(2.0)[1], CAMERA, T_world_camera)
    # To a few hundredths of a voxel: depth is that of the nearest pixel's center.
    assert_at(volume.extract_mesh(), 2.0, within_m=0.02)
    assert abs(np.median(volume.extract_mesh().vertices_m[:, 2]) - 2.0) < 0.002


def test_a_sphere_seen_from_all_sides_is_round(seen_ball: Mesh) -> None:
    radius_m = np.linalg.norm(seen_ball.vertices_m, axis=1)
    assert abs(np.median(radius_m) - 0.5) < 0.01
    assert np.mean(np.abs(radius_m - 0.5) < SETTINGS.voxel_m) > 0.98
    outwards = seen_ball.vertices_m / radius_m[:, None]
    assert np.median(np.sum(outwards * seen_ball.normals, axis=1)) > 0.96
    np.testing.assert_array_equal(np.unique(seen_ball.colors_rgb, axis=0), [BLUE[::-1]])


def test_a_removed_object_is_carved_away() -> None:
    T_world_camera = rigid_transform(
        np.eye(3), [0.0, 0.0, -1.5]
    )  # the ball is 1.5 m before the camera
    depth_m, color_bgr = render_ball(T_world_camera)
    visitor = np.where(depth_m > 0, depth_m, np.float32(3.0)), color_bgr
    with_visitor = fuse_views(visitor, visitor).extract_mesh()
    without = fuse_views(visitor, visitor, *[render_wall(3.0)] * 12).extract_mesh()
    assert np.any(with_visitor.vertices_m[:, 2] < 1.4)
    assert_at(without, 3.0)


def test_near_readings_have_more_weight_than_far_ones() -> None:
    volume = TsdfVolume(SETTINGS)
    near, far = rigid_transform(np.eye(3), [0.0, 0.0, 1.5]), np.eye(4)
    # The same wall: 4 cm too far off from afar, right from nearby.
    for _ in range(3):
        volume.integrate(*render_wall(3.54), CAMERA, far)
        volume.integrate(*render_wall(2.0, BLUE), CAMERA, near)
    mesh = volume.extract_mesh()
    middle = np.all(np.abs(mesh.vertices_m[:, :2]) < 0.3, axis=1)
    assert 3.5 <= np.median(mesh.vertices_m[middle, 2]) < 3.52
    assert mesh.colors_rgb[middle, 2].mean() > mesh.colors_rgb[middle, 0].mean()


def test_one_uncertain_reading_gives_no_surface() -> None:
    assert len(fuse_views(render_wall(3.9)).extract_mesh().triangles) > 0
    finer = replace(SETTINGS, voxel_m=0.01)  # the noise is 21 mm
    assert len(fuse_views(render_wall(3.9), settings=finer).extract_mesh().triangles) == 0


@pytest.mark.parametrize("distance_m", [0.0, 4.5])
def test_no_depth_in_range_gives_no_surface(distance_m: float) -> None:
    volume = fuse_views(render_wall(distance_m))
    assert not volume.has_depth_in_range(render_wall(distance_m)[0])
    mesh = volume.extract_mesh()
    assert [len(part) for part in (mesh.vertices_m, mesh.normals, mesh.triangles)] == [0, 0, 0]


def test_a_full_volume_is_reported_and_still_refined() -> None:
    tight = replace(SETTINGS, memory_mb=3)
    volume = fuse_views(render_wall(1.0), render_wall(1.0), settings=tight)
    before = volume.extract_mesh()
    was_full = volume.is_full
    for _ in range(30):
        volume.integrate(*render_wall(3.5), CAMERA, rigid_transform(so3_exp([0, 3.0, 0]), [0] * 3))
        volume.integrate(*render_wall(1.0, BLUE), CAMERA, np.eye(4))
    after = volume.extract_mesh()
    assert (was_full, volume.is_full, volume.used_fraction) == (False, True, 1.0)
    seen_before = after.vertices_m[:, 2] > 0.5
    assert np.count_nonzero(seen_before) >= len(before.vertices_m)
    assert after.colors_rgb[seen_before, 2].mean() > 150  # blue by now


def test_the_same_frames_give_the_same_bits(seen_ball: Mesh) -> None:
    first, second = (
        fuse_views(render_wall(2.0), render_wall(2.1), render_wall(1.9)).extract_mesh()
        for _ in range(2)
    )
    assert first.vertices_m.tobytes() == second.vertices_m.tobytes()
    assert first.colors_rgb.tobytes() == second.colors_rgb.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()


def test_a_pose_out_of_range_is_skipped() -> None:
    volume = TsdfVolume(SETTINGS)
    far: Array = rigid_transform(np.eye(3), [1e9, 0.0, -1e9])
    volume.integrate(*render_wall(2.0), CAMERA, far)
    assert volume.is_full
    assert len(volume.extract_mesh().triangles) == 0
