"""Alignment of planes with surfaces, and the constrained directions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, adjoint, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.hand_held_sequence import assert_close
from tests.vo_service.odometry.icp.depth_views import (
    FLOOR,
    ROOM,
    WALL,
    add_noise,
    hand_held_pose,
    render_view,
)
from vo_service.odometry.icp.alignment import COARSE_TO_FINE, align, evaluate_alignment
from vo_service.odometry.icp.depth_pyramid import DepthLevel, build_depth_pyramid
from vo_service.odometry.icp.odometry import start_track
from vo_service.odometry.icp.residuals import compute_residuals
from vo_service.odometry.uncertainty import (
    DegeneracyAnalysis,
    analyze_degeneracy,
    point_information,
)

START = build_depth_pyramid(render_view(ROOM, np.eye(4)))
REFERENCE = start_track(START, 4000)

small = st.floats(-1.0, 1.0)


@settings(deadline=None, max_examples=15)
@given(st.tuples(small, small, small), st.tuples(small, small, small))
def test_a_small_motion_is_estimated(turn: tuple[float, ...], shift: tuple[float, ...]) -> None:
    T = rigid_transform(so3_exp(0.015 * np.array(turn)), 0.02 * np.array(shift))
    found = align(
        REFERENCE.planes, build_depth_pyramid(render_view(ROOM, T)), [np.eye(4)], COARSE_TO_FINE
    )
    assert found.has_converged
    assert_close(inverse(found.T_camera_reference), T, 0.003, 0.12)


def test_the_initial_guess_that_fits_best_is_used_by_icp() -> None:
    T = hand_held_pose(8)
    view = build_depth_pyramid(render_view(ROOM, T))
    found = align(
        REFERENCE.planes, view, [hand_held_pose(-20), inverse(T), np.eye(4)], COARSE_TO_FINE
    )
    assert_close(inverse(found.T_camera_reference), T, 0.003, 0.1)


def test_a_result_far_from_the_initial_guess_is_rejected() -> None:
    there = rigid_transform(so3_exp([0.0, 0.0, 0.6]), np.zeros(3))
    found = align(
        REFERENCE.planes, build_depth_pyramid(render_view(ROOM, there)), [np.eye(4)], COARSE_TO_FINE
    )
    assert not found.has_converged


def test_along_a_wall_the_pose_does_not_move() -> None:
    wall = start_track(build_depth_pyramid(add_noise(render_view((WALL,), np.eye(4)), 0)), 4000)
    nearer = rigid_transform(np.eye(3), [0.05, 0.03, 0.04])
    found = align(
        wall.planes,
        build_depth_pyramid(add_noise(render_view((WALL,), nearer), 1)),
        [np.eye(4)],
        COARSE_TO_FINE,
    )
    T = inverse(found.T_camera_reference)
    normal = np.array(WALL[0]) / np.linalg.norm(WALL[0])
    assert abs((T[:3, 3] - nearer[:3, 3]) @ normal) < 0.003
    along = T[:3, 3] - normal * (normal @ T[:3, 3])
    assert np.linalg.norm(along) < 0.002


def test_a_wall_leaves_three_directions_unconstrained_and_two_leave_one() -> None:
    for planes, known in (((WALL,), 3), ((WALL, FLOOR), 5), (ROOM, 6)):
        view = build_depth_pyramid(add_noise(render_view(planes, np.eye(4)), 3))
        self_uncertainty = evaluate_alignment(start_track(view, 4000).planes, view, np.eye(4))
        assert self_uncertainty.degeneracy.observable_axes.shape == (6, known)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_observability_depends_neither_on_units_nor_on_the_origin(seed: int, unit: float) -> None:
    random = np.random.default_rng(seed)
    p, n = random.normal(size=(20, 3)), random.normal(size=(20, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    J = np.hstack([n, np.cross(p, n)])
    q = np.hstack([p, np.ones((20, 1))])
    plain = analyze_degeneracy(J.T @ J, point_information(q.T @ q))
    A = adjoint(rigid_transform(np.eye(3), random.normal(size=3))) @ np.diag([1.0] * 3 + [unit] * 3)
    changed = analyze_degeneracy(A.T @ J.T @ J @ A, A.T @ point_information(q.T @ q) @ A)
    np.testing.assert_allclose(plain.observability, changed.observability, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("clarity", "share"), [(0.5, 0.0), (1.0, 0.0), (4.0, 0.75), (1e9, 1.0)])
def test_information_of_noise_is_subtracted(clarity: float, share: float) -> None:
    axes = np.random.default_rng(3).normal(size=(6, 6))
    observabilities = np.array([clarity, *[1e9] * 5])
    W = DegeneracyAnalysis(observabilities, axes).suppress_noise(np.ones(6, np.bool_))
    information = np.linalg.inv(axes).T @ np.diag(observabilities) @ np.linalg.inv(axes)
    left = axes.T @ W.T @ information @ W @ axes
    np.testing.assert_allclose(np.diag(left)[0], share * clarity, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(np.diag(left)[1:], observabilities[1:], rtol=1e-5)


def test_zero_information_constrains_nothing() -> None:
    nothing = analyze_degeneracy(np.zeros((6, 6)), np.zeros((6, 6)))
    assert not nothing.observability.any()
    assert nothing.observable_axes.shape == (6, 0)
    assert not nothing.suppress_noise(nothing.is_observable).any()


def test_the_step_is_the_derivative_of_the_residuals() -> None:
    """A small motion of the reference's points changes the residuals as the Jacobian says."""
    level, planes = START.levels[0], REFERENCE.planes[0]
    step = np.array([0.002, -0.001, 0.0015, 0.0006, -0.0008, 0.0004])
    moved = rigid_transform(so3_exp(step[3:]), step[:3])
    change = residuals(planes, moved, level) - residuals(planes, np.eye(4), level)
    p, n = planes[:, :3], planes[:, 3:6]
    J = np.hstack([n, np.cross(p, n)]) / (planes[:, 6] * p[:, 2])[:, None]
    both = np.isfinite(change)
    assert both.mean() > 0.9
    assert np.quantile(abs(change - J @ step)[both], 0.9) < 0.1 * np.quantile(abs(J @ step), 0.9)


def residuals(planes: Array, T: Array, level: DepthLevel) -> Array:
    return compute_residuals(planes, T, level.inverse_depth, level.intrinsics)[:, 2]
