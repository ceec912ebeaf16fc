"""The result of `evaluate` as JSON and as a table."""

import dataclasses

import numpy as np
import pytest

from drivers.core.geometry import Trajectory, rigid_transform, so3_exp
from tests.vo_service.tools.evaluation.sample_trajectories import moving_along_x
from vo_service.tools.evaluation.evaluation import Evaluation, evaluate

OTHER_WORLD = rigid_transform(so3_exp([0.1, 0.2, 0.3]), [1.0, 1.0, 1.0])


def walk(seconds: float) -> tuple[Trajectory, Trajectory]:
    """Make a trajectory with 10 % too much motion, and the truth, with 10 poses a second."""
    stamps_s = np.arange(round(10 * seconds) + 1) / 10
    truth = Trajectory(stamps_s, moving_along_x(list(stamps_s)))
    return Trajectory(stamps_s, OTHER_WORLD @ moving_along_x(list(1.1 * stamps_s))), truth


def test_every_metric_of_a_simple_walk() -> None:
    trajectory, truth = walk(seconds=2.0)
    # After alignment the centers coincide: errors are 0.1 |t - 1|, the mean over 21 poses 1.1 / 21.
    expected = Evaluation(
        ate_rmse_m=np.sqrt(2 * 0.01 * 3.85 / 21),
        ate_mean_m=1.1 / 21,
        ate_median_m=0.05,
        ate_max_m=0.1,
        mean_global_error_m=0.1,
        rpe_frame_m=0.01,
        rpe_frame_deg=0.0,
        rpe_1s_m=0.1,
        rpe_1s_deg=0.0,
        coverage=1.0,
        poses=21,
        matched=21,
    )
    assert evaluate(trajectory, truth).as_json() == pytest.approx(
        dataclasses.asdict(expected), abs=1e-9
    )


def test_the_table_is_aligned_and_shows_a_dash_for_none() -> None:
    evaluation = dataclasses.replace(
        evaluate(*walk(seconds=0.5)), ate_rmse_m=0.01234, rpe_frame_deg=1.5, coverage=None
    )
    assert evaluation.as_table().splitlines()[:1] == ["ATE, RMSE              12.34 mm"]
    assert evaluation.as_table().splitlines()[5:] == [
        "RPE, one frame         10.00 mm     1.500 deg",
        "RPE, one second            -            -",
        "coverage                   -",
        "poses                      6",
        "matched                    6",
    ]
