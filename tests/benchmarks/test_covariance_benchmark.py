"""Errors against the covariance told with them: what is counted from where."""

import numpy as np
import pytest

from benchmarks.covariance_measure import NormalizedErrorCollector
from benchmarks.covariance_sequences import make_configs
from drivers.core.geometry import Array, inverse, rigid_transform
from vo_service.types import Estimate

SIGMA = 0.01


def at(x_m: float) -> Array:
    return rigid_transform(np.eye(3), [x_m, 0.0, 0.0])


def told(x_m: float, reference_m: float, is_next: bool, restarted: bool = False) -> Estimate:
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
def watcher() -> NormalizedErrorCollector:
    watching = NormalizedErrorCollector()
    watching.add(told(0.0, 0.0, is_next=True), at(0.0))
    return watching


def test_of_the_first_pose_there_is_no_motion_to_judge(watcher: NormalizedErrorCollector) -> None:
    assert watcher.squares.since_reference == []


def test_errors_are_counted_from_the_reference_and_steps_from_the_last_frame(
    watcher: NormalizedErrorCollector,
) -> None:
    watcher.add(told(1.0 + SIGMA, 0.0, is_next=False), at(1.0))
    watcher.add(told(2.0 + SIGMA, 0.0, is_next=False), at(2.0))
    np.testing.assert_allclose(watcher.squares.since_reference, [1.0, 1.0])
    # The two errors are alike: the step between them is right.
    np.testing.assert_allclose(watcher.squares.step, [1.0, 0.0], atol=1e-12)


def test_from_the_next_reference_on_its_own_error_is_no_more_counted(
    watcher: NormalizedErrorCollector,
) -> None:
    watcher.add(told(1.0 + SIGMA, 0.0, is_next=True), at(1.0))
    watcher.add(told(2.0 + SIGMA, 1.0 + SIGMA, is_next=False), at(2.0))
    np.testing.assert_allclose(watcher.squares.since_reference, [1.0, 0.0], atol=1e-12)


def test_after_a_restart_all_begins_anew(watcher: NormalizedErrorCollector) -> None:
    watcher.add(told(9.0, 9.0, is_next=True, restarted=True), at(1.0))
    watcher.add(told(9.5, 9.0, is_next=False), at(1.5))
    np.testing.assert_allclose(watcher.squares.since_reference, [0.0], atol=1e-12)


def test_each_seed_is_another_room_motion_and_timing() -> None:
    found = make_configs([1, 2, 3, 4])
    assert len({config.motion for config in found.values()}) == 4
    assert len({config.timing for config in found.values()}) == 3
    assert all(f"room{config.seed}" in name for name, config in found.items())
