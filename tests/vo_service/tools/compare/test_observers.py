"""Observers of a run: loop closure uses the estimates and does not change them."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import FRAMES
from tests.vo_service.fakes import good_estimate
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.corner_trajectory import STEPS, odometry_pose, true_pose
from vo_service.config import OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.tools.compare.batch import RunRequest
from vo_service.tools.compare.methods import ConfiguredMethodFactory
from vo_service.tools.compare.observers import (
    NULL_OBSERVER,
    LoopClosureObserverFactory,
    ObserverFactory,
)
from vo_service.tools.compare.run_outcome import CompletedRun, LoopClosureRun
from vo_service.tools.compare.runner import run_method

LOOP_CLOSURE = LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20))


def run_observed(folder: Path, observer: ObserverFactory) -> CompletedRun:
    factory = ConfiguredMethodFactory(OdometryConfig())
    request = RunRequest(
        folder, None, factory, stop_after_compiling=False, observer_factory=observer
    )
    run = run_method(request, lambda message: None)
    assert isinstance(run, CompletedRun)
    return run


def observe_round_trip(last: int) -> LoopClosureRun:
    """Run loop closure on an odometry that drifts and gives no covariance."""
    observer = LOOP_CLOSURE.make()
    for n in range(last + 1):
        frame = replace(render_corner(true_pose(n), n), stamp_s=0.1 * n)
        observer.observe(frame, good_estimate(odometry_pose(n)))
    assert observer.result is not None
    return observer.result


@pytest.mark.slow
def test_estimates_are_the_same_bit_for_bit_with_any_observer(recording: Path) -> None:
    unobserved, observed = (
        run_observed(recording, NULL_OBSERVER),
        run_observed(recording, LOOP_CLOSURE),
    )
    assert unobserved.loop_closure is None
    assert observed.loop_closure is not None
    np.testing.assert_array_equal(
        observed.trajectory.T_world_camera, unobserved.trajectory.T_world_camera, strict=True
    )
    assert len(observed.loop_closure.trajectory) == FRAMES
    assert observed.loop_closure.cpu_ms_per_frame > 0


def test_a_round_trip_is_corrected_without_the_methods_covariance() -> None:
    last = 3 * STEPS
    result = observe_round_trip(last)
    assert min(result.map_keyframes, result.loop_closures) > 0
    end = true_pose(last)[:3, 3]
    drift_m = np.linalg.norm(odometry_pose(last)[:3, 3] - end)
    assert np.linalg.norm(result.trajectory.T_world_camera[-1, :3, 3] - end) < 0.2 * drift_m


def test_without_frames_the_result_is_empty() -> None:
    result = LOOP_CLOSURE.make().result
    assert result is not None
    assert (
        len(result.trajectory),
        result.map_keyframes,
        result.loop_closures,
        result.cpu_ms_per_frame,
    ) == (0, 0, 0, 0.0)
    assert NULL_OBSERVER.make().result is None


def test_settings_are_complete_after_pickling() -> None:
    settings = pickle.loads(pickle.dumps(LOOP_CLOSURE)).settings["loop_closure"]
    assert settings["keyframe_database_mb"] == 20
    assert set(settings) == {"keyframe_database_mb", "source", "scipy"}
    assert LOOP_CLOSURE.config_tables == {"map": {"keyframe_database_mb": 20}}
    assert (NULL_OBSERVER.settings, NULL_OBSERVER.config_tables) == ({}, {})
