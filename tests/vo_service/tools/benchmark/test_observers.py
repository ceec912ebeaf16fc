"""Who hears what a method says: loops gain from it, and the method does not notice."""

import logging
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import FRAMES
from tests.vo_service.fakes import good_estimate
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.loop_closure.corner_trajectory import STEPS, odometry_pose, true_pose
from vo_service.cli.loop_closure_observer import LoopClosureObserverFactory
from vo_service.config import OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.tools.benchmark.messages import RunRequest
from vo_service.tools.benchmark.method_factory import ConfiguredMethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.run import CompletedRun, LoopClosureRun
from vo_service.tools.benchmark.runner import run_method

LOOPS = LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20))


def followed(folder: Path, listener: ObserverFactory) -> CompletedRun:
    recipe = ConfiguredMethodFactory(OdometryConfig())
    job = RunRequest(
        folder, None, recipe, logging.WARNING, stop_after_compiling=False, observer_factory=listener
    )
    return run_method(job, lambda word: None)


def heard_of_a_way_there_and_back(last: int) -> LoopClosureRun:
    """What becomes of an odometry that drifts and says nothing of how sure it is."""
    listener = LOOPS.make()
    for n in range(last + 1):
        frame = replace(render_corner(true_pose(n), n), stamp_s=0.1 * n)
        listener.observe(frame, good_estimate(odometry_pose(n)))
    assert listener.result is not None
    return listener.result


@pytest.mark.slow
def test_what_a_method_says_is_the_same_bit_for_bit_whoever_listens(recording: Path) -> None:
    alone, heard = followed(recording, NULL_OBSERVER), followed(recording, LOOPS)
    assert alone.loop_closure is None
    assert heard.loop_closure is not None
    np.testing.assert_array_equal(
        heard.trajectory.T_world_camera, alone.trajectory.T_world_camera, strict=True
    )
    assert len(heard.loop_closure.trajectory) == FRAMES
    assert heard.loop_closure.cpu_ms_per_frame > 0


def test_a_way_there_and_back_is_corrected_though_the_method_is_never_unsure() -> None:
    last = 3 * STEPS
    found = heard_of_a_way_there_and_back(last)
    assert min(found.map_keyframes, found.loop_closures) > 0
    end = true_pose(last)[:3, 3]
    off_m = np.linalg.norm(odometry_pose(last)[:3, 3] - end)
    assert np.linalg.norm(found.trajectory.T_world_camera[-1, :3, 3] - end) < 0.2 * off_m


def test_of_no_frame_there_is_no_figure_and_no_error() -> None:
    result = LOOPS.make().result
    assert result is not None
    assert (
        len(result.trajectory),
        result.map_keyframes,
        result.loop_closures,
        result.cpu_ms_per_frame,
    ) == (0, 0, 0, 0.0)
    assert NULL_OBSERVER.make().result is None


def test_settings_that_matter_are_told_and_go_to_another_process() -> None:
    loops = pickle.loads(pickle.dumps(LOOPS)).settings["loop_closure"]
    assert loops["keyframe_database_mb"] == 20
    assert set(loops) == {"keyframe_database_mb", "source", "scipy"}
    assert LOOPS.config_tables == {"map": {"keyframe_database_mb": 20}}
    assert (NULL_OBSERVER.settings, NULL_OBSERVER.config_tables) == ({}, {})
