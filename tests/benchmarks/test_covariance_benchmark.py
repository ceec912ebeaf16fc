"""Errors normalized by their reported covariance."""

import numpy as np
import pytest

from benchmarks.covariance import (
    NormalizedErrorCollector,
    make_configs,
    motion_error,
    nees,
    summarize_nees,
)
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from vo_service.types.estimate import Estimate

SIGMA = 0.01


def at(x_m: float) -> Array:
    return rigid_transform(np.eye(3), [x_m, 0.0, 0.0])


def make_estimate(
    x_m: float, reference_m: float, is_next: bool, restarted: bool = False
) -> Estimate:
    return Estimate(
        ok=True,
        reason="",
        T_world_camera=at(x_m),
        T_reference_camera=inverse(at(reference_m)) @ at(x_m),
        covariance=SIGMA**2 * np.eye(6),
        is_next_reference=is_next,
        is_reset=restarted,
    )


@pytest.fixture
def collector() -> NormalizedErrorCollector:
    watching = NormalizedErrorCollector()
    watching.add(make_estimate(0.0, 0.0, is_next=True), at(0.0))
    return watching


def test_the_first_pose_has_no_motion(collector: NormalizedErrorCollector) -> None:
    assert collector.squares.since_reference == []


def test_errors_are_counted_from_the_reference_and_steps_from_the_last_frame(
    collector: NormalizedErrorCollector,
) -> None:
    collector.add(make_estimate(1.0 + SIGMA, 0.0, is_next=False), at(1.0))
    collector.add(make_estimate(2.0 + SIGMA, 0.0, is_next=False), at(2.0))
    np.testing.assert_allclose(collector.squares.since_reference, [1.0, 1.0])
    # Both errors are the same, so the step between them is exact.
    np.testing.assert_allclose(collector.squares.step, [1.0, 0.0], atol=1e-12)


def test_the_error_of_a_new_reference_is_not_counted(
    collector: NormalizedErrorCollector,
) -> None:
    collector.add(make_estimate(1.0 + SIGMA, 0.0, is_next=True), at(1.0))
    collector.add(make_estimate(2.0 + SIGMA, 1.0 + SIGMA, is_next=False), at(2.0))
    np.testing.assert_allclose(collector.squares.since_reference, [1.0, 0.0], atol=1e-12)


def test_a_reset_starts_again(collector: NormalizedErrorCollector) -> None:
    collector.add(make_estimate(9.0, 9.0, is_next=True, restarted=True), at(1.0))
    collector.add(make_estimate(9.5, 9.0, is_next=False), at(1.5))
    np.testing.assert_allclose(collector.squares.since_reference, [0.0], atol=1e-12)


def test_each_seed_has_its_own_room_motion_and_timing() -> None:
    configs = make_configs([1, 2, 3, 4])
    assert len({config.motion for config in configs.values()}) == 4
    assert len({config.timing for config in configs.values()}) == 3
    assert all(f"room{config.seed}" in name for name, config in configs.items())


def sample_errors(covariance: Array, count: int) -> list[Array]:
    return list(np.random.default_rng(3).multivariate_normal(np.zeros(6), covariance, count))


SIGMAS = np.diag([1e-3, 2e-3, 3e-3, 1e-4, 2e-4, 3e-4])


def test_errors_drawn_from_their_covariance_are_consistent() -> None:
    covariance = SIGMAS @ SIGMAS
    statistics = summarize_nees([nees(x, covariance) for x in sample_errors(covariance, 4000)])
    assert statistics is not None
    assert statistics.count == 4000
    assert statistics.mean_per_dof == pytest.approx(1.0, abs=0.05)
    assert statistics.fraction_within_95 == pytest.approx(0.95, abs=0.015)


def test_half_the_true_standard_deviation_gives_four_times_the_nees() -> None:
    covariance = SIGMAS @ SIGMAS / 4.0
    statistics = summarize_nees(
        [nees(x, covariance) for x in sample_errors(4.0 * covariance, 4000)]
    )
    assert statistics is not None
    assert statistics.mean_per_dof == pytest.approx(4.0, abs=0.2)
    assert statistics.fraction_within_95 < 0.5


def test_no_motions_give_no_statistics() -> None:
    assert summarize_nees([]) is None


def test_a_motion_error_is_in_the_end_frame() -> None:
    quarter_turn = so3_exp([0.0, 0.0, np.pi / 2])
    error = motion_error(
        rigid_transform(quarter_turn, [1.0, 0.0, 0.0]),
        rigid_transform(quarter_turn, [1.1, 0.0, 0.0]),
    )
    np.testing.assert_allclose(error, [0.0, -0.1, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
