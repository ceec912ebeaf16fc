"""Errors normalized by their reported covariance."""

import numpy as np
import pytest

from benchmarks.covariance import NormalizedErrorCollector, make_configs
from drivers.core.geometry import Array, inverse, rigid_transform
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
