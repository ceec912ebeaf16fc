import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.evaluation.metrics import motion_error, nees, summarize_nees


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
