"""Errors normalized by their reported covariance."""

import numpy as np
import pytest

from benchmarks.covariance import format_row, make_configs, nees, normalized_errors
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


FIRST = make_estimate(0.0, 0.0, is_next=True)


def test_the_first_pose_has_no_motion() -> None:
    assert normalized_errors([FIRST], np.array([at(0.0)])).shape == (0, 2)


def test_errors_are_counted_from_the_reference_and_steps_from_the_last_frame() -> None:
    estimates = [make_estimate(x + SIGMA, 0.0, is_next=False) for x in (1.0, 2.0)]
    errors = normalized_errors([FIRST, *estimates], np.array([at(0.0), at(1.0), at(2.0)]))
    # Both errors are the same, so the step between them is exact.
    np.testing.assert_allclose(errors, [[1.0, 1.0], [1.0, 0.0]], atol=1e-12)


def test_the_error_of_a_new_reference_is_not_counted() -> None:
    first = make_estimate(1.0 + SIGMA, 0.0, is_next=True)
    second = make_estimate(2.0 + SIGMA, 1.0 + SIGMA, is_next=False)
    errors = normalized_errors([FIRST, first, second], np.array([at(0.0), at(1.0), at(2.0)]))
    np.testing.assert_allclose(errors[:, 0], [1.0, 0.0], atol=1e-12)


def test_a_reset_starts_again() -> None:
    restarted = make_estimate(9.0, 9.0, is_next=True, restarted=True)
    second = make_estimate(9.5, 9.0, is_next=False)
    errors = normalized_errors([FIRST, restarted, second], np.array([at(0.0), at(1.0), at(1.5)]))
    np.testing.assert_allclose(errors[:, 0], [0.0], atol=1e-12)


def test_each_seed_has_its_own_room_motion_and_timing() -> None:
    configs = make_configs([1, 2, 3, 4])
    assert len({config.motion for config in configs.values()}) == 4
    assert len({config.timing for config in configs.values()}) == 3
    assert all(f"room{config.seed}" in name for name, config in configs.items())


@pytest.mark.parametrize(("factor", "within"), [(1.0, 95.0), (2.0, None)])
def test_the_mean_is_the_square_of_the_ratio_to_the_deviation(
    factor: float, within: float | None
) -> None:
    sigmas = np.array([1e-3, 2e-3, 3e-3, 1e-4, 2e-4, 3e-4])
    drawn = factor * sigmas * np.random.default_rng(3).normal(size=(4000, 6))
    T = [rigid_transform(so3_exp(each[3:]), each[:3]) for each in drawn]
    errors = np.array([[nees(np.eye(4), each, np.diag(sigmas**2))] * 2 for each in T])
    name, count, mean, share, *step = format_row("all", errors).split()
    assert (name, count, [mean, share]) == ("all", "4000", step)
    assert float(mean) == pytest.approx(factor**2, rel=0.05)
    assert float(share) == pytest.approx(within, abs=1.5) if within else float(share) < 50.0


def test_no_motions_have_no_figures() -> None:
    assert format_row("none", np.empty((0, 2))).split() == ["none", "0", "-", "-", "-", "-"]


def test_a_motion_error_is_in_the_end_frame() -> None:
    turn = so3_exp([0.0, 0.0, np.pi / 2])
    T_true, T = rigid_transform(turn, [1.0, 0.0, 0.0]), rigid_transform(turn, [1.1, 0.0, 0.0])
    certain_in_x = np.diag([1e-6, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert nees(T_true, T, certain_in_x) == pytest.approx(0.01)
