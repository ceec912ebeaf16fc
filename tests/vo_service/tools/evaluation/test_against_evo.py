"""The metrics agree with evo's (github.com/MichaelGrupp/evo) to 1e-9."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D

from drivers.core.geometry import Array, Trajectory, read_trajectory, rigid_transform, so3_exp
from tests.vo_service.tools.evaluation.sample_trajectories import noisy_copy, random_walk
from vo_service.tools.evaluation.evaluation import evaluate

OTHER_WORLD = rigid_transform(so3_exp([-0.7, 0.4, 2.5]), [1.0, -2.0, 0.5])
T0_S = 1305031449.1  # as large as real stamps, to include their rounding


def to_evo(poses: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(poses.T_world_camera), timestamps=poses.stamps_s)


def evaluate_with_evo(trajectory: Trajectory, truth: Trajectory) -> dict[str, float]:
    reference, estimate = sync.associate_trajectories(
        to_evo(truth), to_evo(trajectory), max_diff=0.02
    )
    relative = {}
    for name, relation in (
        ("rpe_frame_m", metrics.PoseRelation.translation_part),
        ("rpe_frame_deg", metrics.PoseRelation.rotation_angle_deg),
    ):
        rpe = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames)
        rpe.process_data((reference, estimate))
        relative[name] = rpe.get_statistic(metrics.StatisticsType.rmse)
    estimate.align(reference)
    ate = metrics.APE(metrics.PoseRelation.translation_part)
    ate.process_data((reference, estimate))
    statistics = ate.get_all_statistics()
    absolute = {f"ate_{name}_m": statistics[name] for name in ("rmse", "mean", "median", "max")}
    return absolute | relative | {"matched": reference.num_poses}


def assert_agreement(trajectory: Trajectory, truth: Trajectory) -> None:
    ours = evaluate(trajectory, truth).as_json()
    expected = evaluate_with_evo(trajectory, truth)
    assert {name: ours[name] for name in expected} == pytest.approx(expected, rel=0, abs=1e-9)
    assert expected["ate_rmse_m"] > 1e-3  # the errors are not zero


def jittered_stamps(rng: np.random.Generator, count: int, rate_hz: float) -> Array:
    """Make irregular stamps with a tenth of the poses missing and one long gap."""
    stamps_s = T0_S + np.arange(count) / rate_hz + rng.uniform(-0.3, 0.3, count) / rate_hz
    missing = (rng.random(count) < 0.1) | (np.arange(count) // 20 == 3)
    return np.asarray(stamps_s[~missing].round(6))


@pytest.mark.parametrize("truth_hz", [5.0, 20.0, 30.0, 100.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_errors_of_random_walks_equal_those_of_evo(truth_hz: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_walk(rng, jittered_stamps(rng, int(6 * truth_hz), truth_hz))
    stamps_s = jittered_stamps(rng, 180, 30.0)
    assert_agreement(noisy_copy(rng, truth, stamps_s, OTHER_WORLD), truth)


@pytest.mark.parametrize("shift_s", [-0.5, 0.5, 2.0])
def test_errors_of_partial_overlaps_equal_those_of_evo(shift_s: float) -> None:
    rng = np.random.default_rng(7)
    truth = random_walk(rng, T0_S + np.arange(90) / 30)
    assert_agreement(noisy_copy(rng, truth, truth.stamps_s + shift_s + 0.004, OTHER_WORLD), truth)


@pytest.mark.parametrize("name", ["fr1_desk", "fr1_rpy", "fr1_xyz"])
def test_errors_of_a_handheld_camera_equal_those_of_evo(recordings: Path, name: str) -> None:
    rng = np.random.default_rng(3)
    truth = read_trajectory(recordings / "mocap" / f"{name}-groundtruth.txt")
    stamps_s = np.arange(truth.stamps_s[0] - 1.0, truth.stamps_s[-1] + 1.0, 1 / 30)
    assert_agreement(noisy_copy(rng, truth, stamps_s, OTHER_WORLD), truth)
