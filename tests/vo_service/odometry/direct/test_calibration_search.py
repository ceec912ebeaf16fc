"""The first moving frames are tracked with several timings, a bounded number of steps in each."""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import remove_color, remove_depth
from tests.vo_service.odometry.direct.swinging_camera import DELAY_S, READOUT_S, swinging_frames
from vo_service.odometry.direct.calibration_search import SearchedFrame, TimingSearch
from vo_service.odometry.direct.parameters import (
    MAX_SEARCH_STEPS_PER_FRAME,
    NUM_SEARCHED_FRAMES,
    SEARCH_STEPS_S,
)
from vo_service.odometry.direct.view_history import ToldFrame

SIGMAS_S = np.array([0.03, 0.01])


def searched(frame: RgbdFrame) -> SearchedFrame:
    return SearchedFrame.of(ToldFrame.of(frame), focal=0.0)


def begin_search(frames: tuple[RgbdFrame, ...]) -> TimingSearch:
    return TimingSearch(searched(frames[0]), np.eye(4), SIGMAS_S)


def search_all(frames: tuple[RgbdFrame, ...]) -> TimingSearch:
    search = begin_search(frames)
    for frame in frames[1:]:
        if not search.is_complete:
            search.add(searched(frame))
    return search


def test_the_timing_is_found_within_a_step() -> None:
    found = search_all(swinging_frames(READOUT_S, DELAY_S)[:16]).evaluate()
    assert found.is_certain
    assert (np.abs(found.mean - [READOUT_S, DELAY_S]) < SEARCH_STEPS_S).all()


def test_a_global_shutter_fits_best_without_a_correction() -> None:
    found = search_all(swinging_frames(0.0, 0.0)[:16]).evaluate()
    assert not found.is_clear
    assert (found.best.correction == 0.0).all()


def test_a_frame_has_a_bounded_number_of_steps_and_few_trackers_stay_behind() -> None:
    search, before = begin_search(swinging_frames(0.0, 0.0)), 0
    for count, frame in enumerate(swinging_frames(0.0, 0.0)[1 : NUM_SEARCHED_FRAMES + 3], 1):
        search.add(searched(frame))
        steps = sum(len(hypothesis.scores) for hypothesis in search.hypotheses)
        assert steps - before <= MAX_SEARCH_STEPS_PER_FRAME
        assert search.num_compared >= min(count - 2, NUM_SEARCHED_FRAMES - 1)
        before = steps
    assert search.is_complete


def test_a_covered_camera_tells_no_timing_from_another() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)[:12]
    covered = (frames[0], *(remove_depth(remove_color(frame)) for frame in frames[1:]))
    found = search_all(covered).evaluate()
    assert not found.is_clear
    assert found.best.correction.tolist() == [0.0, 0.0]


def test_only_the_uncertain_value_is_searched_for() -> None:
    first = replace(swinging_frames(0.0, 0.0)[0], readout_s=READOUT_S)
    search = TimingSearch(searched(first), np.eye(4), np.array([0.001, 0.01]))
    corrections = np.array([hypothesis.correction for hypothesis in search.hypotheses])
    assert (corrections[:, 0] == 0.0).all()
    assert sorted(corrections[:, 1]) == [-SEARCH_STEPS_S[1], 0.0, SEARCH_STEPS_S[1]]
