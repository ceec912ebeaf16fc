"""Runs that are given some of a recording's frames."""

import logging
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import FRAMES
from tests.vo_service.runs.made_up import recording as made_up
from tests.vo_service.runs.trial_methods import Trial
from vo_service.runs.excerpt import WHOLE, Excerpt
from vo_service.runs.messages import Job, Progress
from vo_service.runs.running import run_in_child
from vo_service.runs.sequence import open_recordings


@pytest.mark.parametrize(
    ("excerpt", "used", "suffix"),
    [
        (WHOLE, list(range(8)), ""),
        (Excerpt(every=3), [0, 3, 6], "-every-3"),
        (Excerpt(first=5), [0, 1, 2, 3, 4], "-first-5"),
        (Excerpt(every=2, first=3), [0, 2], "-first-3-every-2"),
        (Excerpt(every=100), [0], "-every-100"),
    ],
)
def test_every_so_manyth_of_the_first_is_used(
    excerpt: Excerpt, used: list[int], suffix: str
) -> None:
    assert excerpt.of(range(8)) == used
    assert excerpt.suffix == suffix


def test_an_excerpt_of_a_recording_has_its_own_name_and_frames_and_the_same_truth() -> None:
    whole = made_up("walk")
    part = whole.only(Excerpt(every=10))
    assert part.name == "walk-every-10"
    np.testing.assert_array_equal(part.frames_s, whole.frames_s[::10])
    assert part.truth is whole.truth
    assert whole.only(WHOLE).name == "walk"


@pytest.mark.subprocess
def test_the_method_sees_the_frames_of_the_excerpt_alone(recording: Path) -> None:
    excerpt = Excerpt(every=2, first=9)
    expected_s = open_recordings([recording], None)[0].only(excerpt).frames_s
    words: list[object] = []
    job = Job(recording, None, Trial(), logging.WARNING, excerpt)
    outcome = run_in_child(job, 60.0, words.append, threading.Event())
    np.testing.assert_array_equal(outcome.run.frames.stamps_s, expected_s)
    assert len(expected_s) == 5 < FRAMES
    assert Progress(1, 5) in words
