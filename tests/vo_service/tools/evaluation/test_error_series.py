"""The error series agrees with the metrics."""

import numpy as np
import pytest

from tests.vo_service.tools.evaluation.sample_trajectories import noisy_copy, random_walk
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.error_series import error_series
from vo_service.tools.evaluation.metrics import rms


def test_their_means_are_the_metrics_of_the_evaluation() -> None:
    rng = np.random.default_rng(3)
    truth = random_walk(rng, np.arange(60) / 30)
    trajectory = noisy_copy(rng, truth, truth.stamps_s[::2], np.eye(4))
    series, evaluation = error_series(associate(trajectory, truth)), evaluate(trajectory, truth)
    assert (len(series.global_error_m), len(series.step_errors.translation_m)) == (30, 29)
    assert np.mean(series.global_error_m) == pytest.approx(evaluation.mean_global_error_m)
    assert series.global_error_m[0] == pytest.approx(0.0, abs=1e-12)
    assert rms(series.step_errors.translation_m) == pytest.approx(evaluation.rpe_frame_m)
    assert rms(series.step_errors.rotation_deg) == pytest.approx(evaluation.rpe_frame_deg)
