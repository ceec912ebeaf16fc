"""Batched rigid transforms, compared with single ones."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import (
    Array,
    inverse,
    is_rigid,
    rigid_transform,
    skew_matrix,
    so3_exp,
    so3_log,
)
from vo_service.slam.pose_graph.batched_se3 import (
    invert_poses,
    retract_poses,
    skew_matrices,
    so3_exp_batch,
    so3_log_batch,
)

FEW = settings(max_examples=30)
# Each shorter than half a turn.
VECTORS = arrays(np.float64, (3, 3), elements=st.floats(-1.8, 1.8, allow_subnormal=False))
STEPS = arrays(np.float64, (3, 6), elements=st.floats(-3.0, 3.0, allow_subnormal=False))


def stack(steps: Array) -> Array:
    return np.array([rigid_transform(so3_exp(step[3:]), step[:3]) for step in steps])


@FEW
@given(VECTORS)
def test_batched_rotations_equal_single_ones(vectors_rad: Array) -> None:
    each = [so3_exp(vector) for vector in vectors_rad]
    np.testing.assert_allclose(so3_exp_batch(vectors_rad), each, atol=1e-14)
    cross = [skew_matrix(vector) for vector in vectors_rad]
    np.testing.assert_array_equal(skew_matrices(vectors_rad), cross)


@FEW
@given(VECTORS)
def test_batched_rotation_vectors_equal_single_ones(vectors_rad: Array) -> None:
    R = so3_exp_batch(vectors_rad)
    np.testing.assert_allclose(so3_log_batch(R), [so3_log(r) for r in R], atol=1e-9)


@FEW
@given(STEPS)
def test_an_inverse_cancels_its_transform(steps: Array) -> None:
    T = stack(steps)
    np.testing.assert_array_equal(invert_poses(T), [inverse(each) for each in T])
    np.testing.assert_allclose(invert_poses(T) @ T, np.tile(np.eye(4), (3, 1, 1)), atol=1e-13)


@FEW
@given(STEPS)
def test_a_step_is_in_the_axes_of_the_moving_frame(steps: Array) -> None:
    T = stack(steps[::-1])
    np.testing.assert_allclose(retract_poses(T, steps), T @ stack(steps), atol=1e-12)


def test_a_transform_stays_rigid_after_many_steps() -> None:
    T, step = stack(np.full((1, 6), 0.5)), np.full((1, 6), 0.3)
    for _ in range(1000):
        T = retract_poses(T, step)
    assert is_rigid(T[0], tolerance=1e-14)
