"""Who hears what a method says: loops gain from it, and the method does not notice."""

import logging
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import FRAMES
from tests.vo_service.fakes import good
from tests.vo_service.mapping.loops.corner_walk import STEPS, told, truth
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.config import OdometrySettings
from vo_service.runs.following import follow
from vo_service.runs.listening import NOBODY, ListenerRecipe, LoopsRecipe
from vo_service.runs.messages import Job
from vo_service.runs.method_recipe import MethodRecipe
from vo_service.runs.run import LoopsRun, Run
from vo_service.settings import MapSettings

LOOPS = LoopsRecipe(MapSettings(places_mb=20))


def followed(folder: Path, listener: ListenerRecipe) -> Run:
    recipe = MethodRecipe(OdometrySettings())
    job = Job(folder, None, recipe, logging.WARNING, may_end_compiled=False, listener=listener)
    return follow(job, lambda word: None)


def heard_of_a_way_there_and_back(last: int) -> LoopsRun:
    """What becomes of an odometry that drifts and says nothing of how sure it is."""
    listener = LOOPS.make()
    for n in range(last + 1):
        frame = replace(view_of_a_corner(truth(n), n), stamp_s=0.1 * n)
        listener.hear(frame, good(told(n)))
    assert listener.result is not None
    return listener.result


@pytest.mark.slow
def test_what_a_method_says_is_the_same_bit_for_bit_whoever_listens(recording: Path) -> None:
    alone, heard = followed(recording, NOBODY), followed(recording, LOOPS)
    assert alone.with_loops is None
    assert heard.with_loops is not None
    np.testing.assert_array_equal(
        heard.trajectory.T_world_camera, alone.trajectory.T_world_camera, strict=True
    )
    assert len(heard.with_loops.trajectory) == FRAMES
    assert heard.with_loops.cpu_ms > 0


def test_a_way_there_and_back_is_corrected_though_the_method_is_never_unsure() -> None:
    last = 3 * STEPS
    found = heard_of_a_way_there_and_back(last)
    assert min(found.places, found.loops) > 0
    end = truth(last)[:3, 3]
    off_m = np.linalg.norm(told(last)[:3, 3] - end)
    assert np.linalg.norm(found.trajectory.T_world_camera[-1, :3, 3] - end) < 0.2 * off_m


def test_of_no_frame_there_is_no_figure_and_no_error() -> None:
    result = LOOPS.make().result
    assert result is not None
    assert (len(result.trajectory), result.places, result.loops, result.cpu_ms) == (0, 0, 0, 0.0)
    assert NOBODY.make().result is None


def test_settings_that_matter_are_told_and_go_to_another_process() -> None:
    loops = pickle.loads(pickle.dumps(LOOPS)).settings["loops"]
    assert loops["places_mb"] == 20
    assert set(loops) == {"places_mb", "source", "scipy"}
    assert LOOPS.tables == {"map": {"places_mb": 20}}
    assert (NOBODY.settings, NOBODY.tables) == ({}, {})
