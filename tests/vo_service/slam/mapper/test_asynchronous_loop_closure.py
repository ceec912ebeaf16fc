"""Loop closure in the mapper process: relocalization, saved and loaded maps."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import T_BODY_CAMERA, Array, inverse
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.outputs.recorder.recorder_inputs import command_error
from tests.vo_service.slam.corner_trajectory import (
    STEPS,
    make_update,
    odometry_pose,
    true_pose,
)
from tests.vo_service.slam.mapper.wall_sequence import COARSE, mapper_pid, running_mapper
from tests.waiting import wait_until
from vo_service.slam.mapper.client import LiveMapper
from vo_service.slam.relocalization import AsynchronousLoopClosure, RelocalizationResult

pytestmark = pytest.mark.subprocess

WITH_LOOP_CLOSURE = replace(COARSE, loop_closure=True)
NAME = "corner"


@contextmanager
def walking(folder: Path) -> Iterator[LiveMapper]:
    """A mapper with the path out: every second step is a keyframe."""
    with running_mapper(folder, WITH_LOOP_CLOSURE) as opened:
        go(opened, 0, STEPS)
        yield opened


def go(opened: LiveMapper, first: int, last: int, by: int = 2) -> None:
    before = opened.loop_closure.snapshot.keyframes
    for wanted, step in enumerate(range(first, last + 1, by), before + 1):
        opened.on_update(make_update(step))
        wait_until(partial(_has, opened, wanted), f"place {wanted}")


def _has_keyframes(opened: LiveMapper, keyframes: int) -> bool:
    return opened.state.mesh_keyframes >= keyframes


def _has(opened: LiveMapper, places: int) -> bool:
    return opened.loop_closure.snapshot.keyframes >= places


def relocalize(opened: LiveMapper, T_world_camera: Array) -> RelocalizationResult:
    """Relocalize a view."""
    loops = opened.loop_closure
    assert isinstance(loops, AsynchronousLoopClosure)
    answers: list[RelocalizationResult] = []

    def has_come() -> bool:
        answers.extend(loops.poll_results())
        return bool(answers)

    loops.query(render_corner(T_world_camera, 99))
    wait_until(has_come, "an answer")
    return answers[0]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a saved map."""
    folder = tmp_path_factory.mktemp("state") / "maps"
    with walking(folder) as opened:
        file = opened.save(NAME).saving
        wait_until(lambda: opened.state.saved == file, f"{file}")
    return folder


def test_the_mapper_process_localizes_a_view_of_a_known_keyframe(tmp_path: Path) -> None:
    with walking(tmp_path / "maps") as opened:
        result = relocalize(opened, true_pose(2))
        assert result.seq == 99
        assert np.allclose(result.T_world_camera[:3, 3], odometry_pose(2)[:3, 3], atol=0.01)
        assert opened.loop_closure.snapshot.is_localized
        assert opened.warning == ""


def test_a_saved_map_is_recognized_after_a_restart(saved: Path) -> None:
    assert sorted(file.name for file in saved.iterdir()) == ["corner.keyframes", "corner.ply"]
    with running_mapper(saved, replace(WITH_LOOP_CLOSURE, load=NAME)) as opened:
        wait_until(lambda: opened.state.loaded.endswith("corner.keyframes"), "the map")
        wait_until(lambda: "available: corner" in command_error(lambda: opened.load("attic")))
        assert not opened.loop_closure.snapshot.is_localized
        places = opened.loop_closure.snapshot.keyframes
        assert places > STEPS // 2
        before = opened.state.mesh_keyframes
        for keyframes, step in enumerate((STEPS + 1, STEPS + 4, STEPS + 7), before + 1):
            opened.on_update(make_update(step))
            wait_until(partial(_has_keyframes, opened, keyframes), "a keyframe")
        wait_until(lambda: opened.loop_closure.snapshot.is_localized, "a place that is known")
        T_map_camera = (
            opened.loop_closure.snapshot.T_map_odom @ T_BODY_CAMERA @ odometry_pose(STEPS + 7)
        )
        expected = T_BODY_CAMERA @ true_pose(STEPS + 7)
        assert np.linalg.norm((inverse(expected) @ T_map_camera)[:3, 3]) < 0.05


def test_a_camera_at_rest_is_localized_in_a_loaded_map(saved: Path) -> None:
    with running_mapper(saved, WITH_LOOP_CLOSURE) as opened:
        opened.on_update(make_update(STEPS))
        wait_until(lambda: opened.state.mesh_keyframes == 1, "a keyframe")
        opened.load(NAME)
        wait_until(lambda: opened.state.loaded.endswith("corner.keyframes"), "the map")
        wait_until(lambda: opened.state.mesh_keyframes == 0, "the keyframe of before to go")
        opened.on_update(make_update(STEPS))
        wait_until(lambda: opened.loop_closure.snapshot.is_localized, "a place that is known")
        wait_until(lambda: opened.state.mesh_keyframes == 1, "a keyframe in that map")


def test_keyframes_of_a_killed_process_are_removed_and_made_again(tmp_path: Path) -> None:
    with walking(tmp_path / "maps") as opened:
        first = mapper_pid()
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: opened.loop_closure.snapshot.keyframes == 0, "the loss")
        wait_until(lambda: opened.is_ready and mapper_pid() != first, "another process")
        go(opened, STEPS, STEPS)


def test_without_keyframes_there_is_no_loop_closure_and_no_map_can_be_loaded(
    tmp_path: Path,
) -> None:
    with running_mapper(tmp_path, COARSE) as opened:
        assert opened.loop_closure.snapshot.keyframes == 0
        (tmp_path / "some.keyframes").write_bytes(b"")
        wait_until(
            lambda: "available: some" in command_error(lambda: opened.load("x")), "the folder"
        )
        opened.load("some")
        wait_until(lambda: "loop closure is disabled" in opened.warning, "the warning")
