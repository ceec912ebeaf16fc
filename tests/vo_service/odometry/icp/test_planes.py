"""Planes of a depth image and their sampling."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vo_service.odometry.icp.depth_views import (
    FLOOR,
    ROOM,
    WALL,
    hand_held_pose,
    make_frame,
    render_view,
)
from vo_service.odometry.icp.depth_pyramid import build_depth_pyramid
from vo_service.odometry.icp.planes import find_planes, normal_bins, sample_balanced


def test_planes_lie_on_the_surface_and_face_as_it_does() -> None:
    T = hand_held_pose(3)
    normal, distance = np.array(WALL[0]), WALL[1]
    length = float(np.linalg.norm(normal))
    for level in build_depth_pyramid(render_view((WALL,), T)).levels:
        planes = find_planes(level, 4000)
        assert len(planes) > 50
        np.testing.assert_allclose(
            planes[:, 3:6] @ T[:3, :3].T, [normal / length] * len(planes), atol=0.02
        )
        world = planes[:, :3] @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(world @ normal, distance, atol=0.003)
        np.testing.assert_allclose((planes[:, :3] * planes[:, 3:6]).sum(axis=1), planes[:, 6])


def test_no_plane_spans_a_depth_edge() -> None:
    depth_m = np.full((240, 320), 1.0)
    depth_m[:, 160:] = 2.0
    z = find_planes(build_depth_pyramid(make_frame(depth_m)).levels[0], 4000)[:, 2]
    assert np.all((abs(z - 1.0) < 0.01) | (abs(z - 2.0) < 0.01))
    assert 0.3 < np.mean(z < 1.5) < 0.7


def test_rare_normals_are_kept_in_a_small_selection() -> None:
    level = build_depth_pyramid(render_view(ROOM, np.eye(4))).levels[0]
    floor = np.array(FLOOR[0]) / np.linalg.norm(FLOOR[0])
    on_floor = [np.mean(find_planes(level, n)[:, 3:6] @ floor > 0.9) for n in (4000, 300)]
    assert on_floor[1] > 1.5 * on_floor[0] > 0.0


@given(st.lists(st.integers(0, 17), max_size=200), st.integers(1, 100))
def test_a_selection_has_its_size_and_is_balanced_over_the_bins(
    bins: list[int], budget: int
) -> None:
    labels = np.array(bins, np.int64)
    chosen = sample_balanced(labels, budget)
    assert np.all(np.diff(chosen) > 0)
    counts = np.bincount(labels, minlength=18)
    taken = np.bincount(labels[chosen], minlength=18)
    assert len(chosen) == len(bins) or len(bins) > budget
    cut = taken < counts
    if len(bins) > budget:
        assert len(chosen) <= max(budget, 0)
        # No bin that was cut gave more than any other could have given.
        assert not cut.any() or taken[cut].max() == taken[cut].min() >= taken[~cut].max(initial=0)


@settings(max_examples=30)
@given(st.floats(-np.pi, np.pi), st.floats(0.0, 1.4))
def test_every_direction_that_faces_the_camera_has_a_bin(around: float, aside: float) -> None:
    normal = [np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), np.cos(aside)]
    (found,) = normal_bins(np.array([[0.0, 0.0, 1.0, *normal, 1.0]]))
    assert 0 <= found < 18
