"""Scale of a motion by known points."""

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.sfm.ray_pairs import MOTION, SIGMA, make_pairs
from tests.vo_service.odometry.sfm.sideways_sequence import remove_depth, render_view
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.points import backproject_features
from vo_service.odometry.sfm.essential import UnscaledMotion, find_unscaled_motion
from vo_service.odometry.sfm.scale import (
    FirstDepthScale,
    GivenBaselineScale,
    InitialPair,
    median_sigma,
    propose_scaled_motions,
)


def test_known_points_give_the_motion_its_length() -> None:
    pairs = make_pairs(MOTION, known_to=0.05, noise=0.3 * SIGMA)
    motions = propose_scaled_motions(find_unscaled_motion(pairs, seed=1), pairs)
    assert len(motions) == 2
    for T_camera_reference in motions:
        length_m = np.linalg.norm(T_camera_reference[:3, 3])
        assert length_m == pytest.approx(np.linalg.norm(MOTION[:3, 3]), rel=0.05)


def test_a_pure_rotation_has_length_zero_for_any_direction() -> None:
    turn = rigid_transform(so3_exp([0.02, 0.08, 0.0]), np.zeros(3))
    pairs = make_pairs(turn, known_to=0.05, noise=0.2 * SIGMA)
    found = find_unscaled_motion(pairs, seed=1)
    assert found is not None
    right = UnscaledMotion(inverse(turn)[:3, :3], found.t, np.ones(len(pairs), np.bool_))
    (T_camera_reference,) = propose_scaled_motions(right, pairs)
    assert np.linalg.norm(T_camera_reference[:3, 3]) < 0.002


def test_a_motion_shorter_than_any_parallax_is_measured() -> None:
    step = rigid_transform(np.eye(3), [0.004, 0.0, 0.0])
    pairs = make_pairs(step, known_to=0.05)
    still = UnscaledMotion(np.eye(3), np.array([0.0, 1.0, 0.0]), np.ones(len(pairs), np.bool_))
    T_camera_reference = propose_scaled_motions(still, pairs)[-1]
    np.testing.assert_allclose(T_camera_reference[:3, 3], [-0.004, 0.0, 0.0], atol=2e-4)


def test_points_of_unknown_depth_give_no_scale() -> None:
    pairs = make_pairs(MOTION)
    assert propose_scaled_motions(find_unscaled_motion(pairs, seed=1), pairs) == []
    assert propose_scaled_motions(None, make_pairs(MOTION, known_to=0.05)) == []


def first_pair(with_depth: bool = True) -> InitialPair:
    """Points that are as far as they are, in units of a quarter of a meter."""
    frame = render_view(0)
    features = SurfExtractor(300).extract(frame.gray)
    depth_m = backproject_features(features, frame).position_m[:, 2]
    index = np.flatnonzero(depth_m)
    shown = frame if with_depth else remove_depth(frame)
    return InitialPair(shown, features, frame.stamp_s + 0.2, index, 0.25 / depth_m[index])


def spoilt(pair: InitialPair) -> Array:
    inverse_depth = pair.inverse_depth.copy()
    inverse_depth[::4] *= 5.0
    return inverse_depth


def test_the_first_depth_gives_the_scale() -> None:
    scale = FirstDepthScale().estimate_scale(first_pair())
    assert scale is not None
    assert scale.metres_per_unit == pytest.approx(0.25, rel=1e-6)
    assert scale.log_sigma < 1e-6


def test_outliers_change_the_scale_little() -> None:
    pair = first_pair()
    worse = InitialPair(pair.frame, pair.features, pair.stamp_s, pair.index, spoilt(pair))
    scale = FirstDepthScale().estimate_scale(worse)
    assert scale is not None
    assert scale.metres_per_unit == pytest.approx(0.25, rel=0.01)


def test_without_depth_there_is_no_scale() -> None:
    assert FirstDepthScale().estimate_scale(first_pair(with_depth=False)) is None


def test_a_baseline_is_requested_for_the_two_stamps() -> None:
    asked: list[tuple[float, float]] = []

    def distance_m(from_s: float, to_s: float) -> float:
        asked.append((from_s, to_s))
        return 0.3

    scale = GivenBaselineScale(distance_m).estimate_scale(first_pair())
    assert scale is not None
    assert scale.metres_per_unit == 0.3
    assert asked == [(0.0, 0.2)]


@pytest.mark.parametrize("distance_m", [0.0, 1e-4, float("nan"), float("inf")])
def test_two_stamps_of_one_position_give_no_scale(distance_m: float) -> None:
    assert GivenBaselineScale(lambda _from, _to: distance_m).estimate_scale(first_pair()) is None


def test_the_median_of_many_points_has_a_smaller_sigma() -> None:
    values = np.random.default_rng(0).normal(0.0, 0.1, 10000)
    assert median_sigma(values) == pytest.approx(1.2533 * 0.1 / 100, rel=0.1)
    assert median_sigma(values[:100]) > 5 * median_sigma(values)
