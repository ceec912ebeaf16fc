"""Runs that are given some of a recording's frames."""

import logging
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import FRAMES
from tests.vo_service.tools.benchmark.faulty_methods import FaultyMethodFactory
from tests.vo_service.tools.benchmark.sample_runs import make_recording as made_up
from vo_service.tools.benchmark.frame_selection import ALL_FRAMES, FrameSelection
from vo_service.tools.benchmark.messages import RunProgress, RunRequest
from vo_service.tools.benchmark.recordings import open_recordings
from vo_service.tools.benchmark.subprocess_run import run_in_subprocess


@pytest.mark.parametrize(
    ("excerpt", "used", "suffix"),
    [
        (ALL_FRAMES, list(range(8)), ""),
        (FrameSelection(step=3), [0, 3, 6], "-every-3"),
        (FrameSelection(max_frames=5), [0, 1, 2, 3, 4], "-first-5"),
        (FrameSelection(step=2, max_frames=3), [0, 2], "-first-3-every-2"),
        (FrameSelection(step=100), [0], "-every-100"),
    ],
)
def test_every_so_manyth_of_the_first_is_used(
    excerpt: FrameSelection, used: list[int], suffix: str
) -> None:
    assert excerpt.select(range(8)) == used
    assert excerpt.suffix == suffix


def test_an_excerpt_of_a_recording_has_its_own_name_and_frames_and_the_same_truth() -> None:
    whole = made_up("walk")
    part = whole.select(FrameSelection(step=10))
    assert part.name == "walk-every-10"
    np.testing.assert_array_equal(part.frame_stamps_s, whole.frame_stamps_s[::10])
    assert part.truth is whole.truth
    assert whole.select(ALL_FRAMES).name == "walk"


@pytest.mark.subprocess
def test_the_method_sees_the_frames_of_the_excerpt_alone(recording: Path) -> None:
    excerpt = FrameSelection(step=2, max_frames=9)
    expected_s = open_recordings([recording], None)[0].select(excerpt).frame_stamps_s
    words: list[object] = []
    job = RunRequest(recording, None, FaultyMethodFactory(), logging.WARNING, excerpt)
    outcome = run_in_subprocess(job, 60.0, words.append, threading.Event())
    np.testing.assert_array_equal(outcome.run.frames.stamps_s, expected_s)
    assert len(expected_s) == 5 < FRAMES
    assert RunProgress(1, 5) in words
