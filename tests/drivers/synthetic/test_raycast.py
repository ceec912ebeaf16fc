from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from drivers.synthetic.raycast import FAR_M, RaycastScene, RayGrid, cast_rays, prepare_scene
from drivers.synthetic.renderer import pixel_rays
from drivers.synthetic.room import build_room
from drivers.synthetic.solids import Solid, SolidArrays, SolidKind, make_solid
from drivers.synthetic.textures import flat_color

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
GRID = RayGrid.from_rays(pixel_rays(CAMERA, np.zeros(5)))
CENTER = (24, 32)
GRAY = flat_color((128.0, 128.0, 128.0))
# A camera at the origin that looks along the world's y, upright.
FORWARD = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
ANGLES = st.floats(-1.2, 1.2)


def see(solids: list[Solid], T: Array) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    view = prepare_scene(
        SolidArrays.pack(solids), GRID, np.repeat(T[None], CAMERA.height, axis=0)[None]
    )
    return cast_view(view)


def cast_view(view: RaycastScene) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    return cast_rays(GRID.rays, view.kind, view.frames, view.candidates, view.near_m)


def test_a_wall_seen_straight_on_has_one_depth() -> None:
    wall = make_solid((0, 3.0, 0), (20, 1.0, 20), GRAY)
    depth_m, solid = see([wall], rigid_transform(FORWARD, (0, 0, 0)))
    np.testing.assert_allclose(depth_m, 2.5, rtol=1e-6)
    assert np.all(solid == 0)


@given(ANGLES, ANGLES, ANGLES, st.floats(-1, 1), st.floats(-1, 1))
@settings(max_examples=30)
def test_a_room_has_the_depth_of_its_nearest_plane_ahead(
    a: float, b: float, c: float, x: float, y: float
) -> None:
    T = rigid_transform(so3_exp([a, b, c]) @ FORWARD, (x, y, 0.3))
    depth_m, _ = see([make_solid((0, 0, 0), (4, 5, 3), GRAY, kind=SolidKind.ROOM)], T)
    d = np.dstack([GRID.rays, np.ones(GRID.rays.shape[:2])]) @ T[:3, :3].T
    ahead = (np.sign(d) * (2.0, 2.5, 1.5) - T[:3, 3]) / d
    np.testing.assert_allclose(depth_m, ahead.min(axis=2), rtol=1e-5)


def test_the_nearer_box_hides_the_further_one() -> None:
    near, far = (
        make_solid((0, 1.0, 0), (0.2, 0.2, 0.2), GRAY),
        make_solid((0, 3.0, 0), (9, 0.2, 9), GRAY),
    )
    depth_m, solid = see([far, near], rigid_transform(FORWARD, (0, 0, 0)))
    assert solid[CENTER] == 1
    assert np.isclose(depth_m[CENTER], 0.9)
    assert solid[0, 0] == 0
    assert np.isclose(depth_m[0, 0], 2.9)


def test_a_turned_box_is_hit_at_its_turned_face() -> None:
    """A cube of side 1 turned by 45 degrees shows its edge, sqrt(1/2) before its center."""
    solids = [make_solid((0, 3.0, 0), (1, 1, 1), GRAY, yaw_rad=np.pi / 4)]
    T = rigid_transform(FORWARD, (0.5 / CAMERA.fx * -3.0, 0, 0))
    depth_m, _ = see(solids, T)
    assert abs(depth_m[CENTER] - (3.0 - np.sqrt(0.5))) < 0.05


def test_a_sphere_is_hit_at_its_radius_and_empty_space_is_far() -> None:
    depth_m, solid = see(
        [make_solid((0, 2, 0), (1, 1, 1), GRAY, kind=SolidKind.SPHERE)], np.eye(4) @ pose()
    )
    x, y = GRID.rays[CENTER]
    a, c = x * x + y * y + 1, 2.0 * 2.0 - 0.25
    assert np.isclose(depth_m[CENTER], (2.0 - np.sqrt(4.0 - a * c)) / a, rtol=1e-6)
    assert solid[0, 0] == -1
    assert depth_m[0, 0] == np.float32(FAR_M)


def test_rays_pass_through_an_open_cylinder() -> None:
    down = rigid_transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 2.0))
    tube, floor = (
        make_solid((0, 0, 0.5), (0.6, 0.6, 1.0), GRAY, kind=SolidKind.CYLINDER),
        make_solid((0, 0, -0.1), (9, 9, 0.2), GRAY),
    )
    depth_m, solid = see([tube, floor], down)
    assert solid[CENTER] == 1
    assert np.isclose(depth_m[CENTER], 2.0)
    assert 0 in solid


def pose() -> Array:
    return rigid_transform(FORWARD, (0, 0, 0))


@given(ANGLES, ANGLES, ANGLES, st.integers(0, 5))
@settings(max_examples=10)
def test_testing_only_candidates_changes_nothing(a: float, b: float, c: float, s: int) -> None:
    """Compare culling by tile, with a different pose for every row, with testing every solid."""
    solids = build_room(s, np.array([[0.0, 0.0, 1.5]]), bare_wall=False, twin_corners=False)
    turns = np.linspace(-0.01, 0.01, CAMERA.height)
    T = np.array(
        [
            rigid_transform(so3_exp([a, b, c]) @ FORWARD @ so3_exp([0, t, 0]), (t, 0, 1.5))
            for t in turns
        ]
    )
    view = prepare_scene(SolidArrays.pack(solids), GRID, T[None])
    every = np.argsort(view.near_m, kind="stable").astype(np.int32)
    lists = np.tile(np.append(every, np.int32(-1)), (*view.candidates.shape[:2], 1))
    for culled, complete in zip(
        cast_view(view), cast_view(replace(view, candidates=lists)), strict=True
    ):
        np.testing.assert_array_equal(culled, complete)


def test_the_room_is_closed_in_every_direction() -> None:
    solids = build_room(1, np.array([[0.0, 0.0, 1.5]]), bare_wall=False, twin_corners=False)
    for yaw in np.arange(0.0, 6.0, 1.0):
        T = inverse(rigid_transform(so3_exp([0, yaw, 0]) @ FORWARD.T, (0, 0, 0)))
        T[2, 3] = 1.5
        assert see(solids, T)[1].min() >= 0
