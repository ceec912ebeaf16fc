"""Accumulated covariance along a chain of motions that share references."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import (
    Array,
    inverse,
    rigid_transform,
    so3_exp,
    so3_log,
    transport_covariance,
)
from vo_service.odometry.uncertainty import CovarianceAccumulator, diagonal_covariance
from vo_service.types.estimate import Estimate

SIGMAS = np.array([0.01, 0.02, 0.015, 0.01, 0.005, 0.02])
STEP = np.diag(SIGMAS**2)


def moved(k: float) -> Array:
    return rigid_transform(so3_exp([0.1 * k, -0.05 * k, 0.2 * k]), [0.2 * k, 0.1, k])


def motion(T_reference_camera: Array, is_next_reference: bool = True) -> Estimate:
    return Estimate(
        True, "", np.eye(4), T_reference_camera, STEP, is_next_reference=is_next_reference
    )


def test_the_first_pose_has_the_smallest_covariance() -> None:
    covariance = CovarianceAccumulator()
    assert 0.0 < covariance.pose.trace() < 1e-6
    np.testing.assert_array_equal(covariance.step, np.zeros((6, 6)))


def test_from_frame_to_frame_covariances_accumulate() -> None:
    covariance, T = CovarianceAccumulator(), moved(0.3)
    expected = covariance.pose
    for _ in range(5):
        covariance.add(motion(T), T)
        expected = transport_covariance(expected, T) + STEP
        np.testing.assert_allclose(covariance.pose, expected)
        np.testing.assert_allclose(covariance.step, STEP)


def test_biased_errors_add_up_as_standard_deviations() -> None:
    covariance, T = CovarianceAccumulator(), rigid_transform(np.eye(3), [0.0, 0.0, 0.0])
    for _ in range(4):
        covariance.add(replace(motion(T), has_biased_error=True), T)
    sigmas = np.sqrt(np.diag(covariance.pose))
    np.testing.assert_allclose(sigmas, 4.0 * SIGMAS, rtol=0.02)


def test_a_biased_error_after_others_adds_no_more_than_itself() -> None:
    covariance, T = CovarianceAccumulator(), np.eye(4)
    for _ in range(100):
        covariance.add(motion(T), T)
    covariance.add(replace(motion(T), has_biased_error=True), T)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance.pose)), 11.0 * SIGMAS, rtol=0.01)


def test_against_one_reference_covariances_do_not_accumulate() -> None:
    covariance, first = CovarianceAccumulator(), CovarianceAccumulator().pose
    last = np.eye(4)
    for k in range(1, 20):
        T = moved(0.01 * k)
        covariance.add(motion(T, is_next_reference=False), inverse(last) @ T)
        np.testing.assert_allclose(covariance.pose, transport_covariance(first, T) + STEP)
        last = T


def test_a_step_between_frames_of_one_reference_excludes_the_reference_covariance() -> None:
    covariance, T, further = CovarianceAccumulator(), moved(0.1), moved(0.2)
    covariance.add(motion(T, is_next_reference=False), T)
    step = inverse(T) @ further
    covariance.add(motion(further, is_next_reference=True), step)
    np.testing.assert_allclose(covariance.step, 0.5 * (transport_covariance(STEP, step) + STEP))
    # The last frame is the reference itself now.
    covariance.add(motion(T), T)
    np.testing.assert_allclose(covariance.step, STEP)


def test_a_new_reference_has_its_covariance_as_a_pose() -> None:
    covariance, T = CovarianceAccumulator(), moved(0.4)
    covariance.add(motion(T, is_next_reference=True), T)
    before = covariance.pose
    covariance.add(motion(T, is_next_reference=False), T)
    np.testing.assert_allclose(covariance.pose, transport_covariance(before, T) + STEP)


def test_a_reset_drops_everything() -> None:
    covariance, T = CovarianceAccumulator(), moved(0.4)
    for is_next_reference in (True, False):
        covariance.add(motion(T, is_next_reference), T)
    covariance.reset()
    np.testing.assert_array_equal(covariance.pose, CovarianceAccumulator().pose)
    np.testing.assert_array_equal(covariance.step, np.zeros((6, 6)))
    covariance.add(motion(T), T)
    np.testing.assert_allclose(covariance.step, STEP)


@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.booleans()), min_size=1, max_size=8))
def test_covariances_are_symmetric_and_a_step_has_at_least_half_of_its_last_motion(
    motions: list[tuple[float, bool]],
) -> None:
    covariance = CovarianceAccumulator()
    for k, is_next_reference in motions:
        covariance.add(motion(moved(k), is_next_reference), moved(k))
        for each, least in ((covariance.pose, STEP), (covariance.step, 0.5 * STEP)):
            np.testing.assert_allclose(each, each.T, atol=1e-12)
            assert np.linalg.eigvalsh(each - least).min() > -1e-12


def test_pose_errors_match_their_covariance() -> None:
    """Many samples of motions with the given covariance: two keyframes, three frames on each."""
    random, errors = np.random.default_rng(3), []
    reference, covariance = moved(0.3), CovarianceAccumulator()
    for is_next_reference in (False, False, True, False, False, False):
        covariance.add(motion(reference, is_next_reference), np.eye(4))
    for _ in range(2000):
        T = shaken(reference, random) @ shaken(reference, random)
        off = inverse(reference @ reference) @ T
        errors.append(np.concatenate([off[:3, 3], so3_log(off[:3, :3])]))
    expected = transport_covariance(STEP, reference) + STEP
    # But for what no pose is surer than.
    np.testing.assert_allclose(covariance.pose, expected, atol=1e-6)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.cov(np.array(errors).T) / scale, expected / scale, atol=0.12)


def test_step_errors_match_their_covariance() -> None:
    """Two frames with equal parts of own errors and of the keyframe's."""
    random, errors, covariance = np.random.default_rng(3), [], CovarianceAccumulator()
    for _ in range(2):
        covariance.add(motion(np.eye(4), is_next_reference=False), np.eye(4))
    for _ in range(2000):
        of_keyframe, of_last, of_this = random.normal(size=(3, 6)) * SIGMAS * np.sqrt(0.5)
        errors.append((of_keyframe + of_this) - (of_keyframe + of_last))
    scale = np.outer(SIGMAS, SIGMAS)
    np.testing.assert_allclose(
        np.cov(np.array(errors).T) / scale, covariance.step / scale, atol=0.1
    )


def shaken(T: Array, random: np.random.Generator) -> Array:
    """T with a random small motion in the camera's axes."""
    off = random.normal(size=6) * SIGMAS
    return T @ rigid_transform(so3_exp(off[3:]), off[:3])


def test_a_diagonal_covariance_is_isotropic() -> None:
    np.testing.assert_allclose(diagonal_covariance(0.1, 0.2), np.diag([0.01] * 3 + [0.04] * 3))
