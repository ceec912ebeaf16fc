"""The first moving frames are tracked with several timings."""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    WALL,
    add_noise,
    make_empty_frame,
    remove_color,
    remove_depth,
    render_view,
)
from tests.vo_service.odometry.direct.swinging_camera import DELAY_S, READOUT_S, swinging_frames
from vo_service.odometry.direct.calibration_search import TimingSearch, TimingSearchResult
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.parameters import SEARCH_STEPS_S, SUFFICIENT_SEARCH_SCORE_GAIN

SIGMAS_S = np.array([0.03, 0.01])


def begin_search(first: RgbdFrame, sigmas_s: Array = SIGMAS_S) -> TimingSearch:
    images = build_image_pyramid(first)
    keyframe = make_keyframe(first, images, np.eye(4), zero_motion(), ALL_STATIC)
    return TimingSearch(sigmas_s, keyframe)


def search_all(frames: tuple[RgbdFrame, ...]) -> TimingSearchResult:
    search, found = begin_search(frames[0]), None
    for frame in frames[1:]:
        if found is None or not found.is_last:
            search.add(build_image_pyramid(frame))
            found = search.evaluate()
    assert found is not None
    return found


def test_the_timing_is_found_within_a_step() -> None:
    found = search_all(swinging_frames(READOUT_S, DELAY_S)[:16])
    assert found.is_clear
    assert (np.abs(found.mean - [READOUT_S, DELAY_S]) < SEARCH_STEPS_S).all()


def test_a_global_shutter_fits_best_without_a_correction() -> None:
    found = search_all(swinging_frames(0.0, 0.0)[:16])
    assert not found.is_clear
    assert (found.best.correction == 0.0).all()


def test_a_covered_camera_tells_no_timing_from_another() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)[:12]
    covered = (frames[0], *(remove_depth(remove_color(frame)) for frame in frames[1:]))
    found = search_all(covered)
    assert not found.is_clear
    assert found.best.correction.tolist() == [0.0, 0.0]


def test_degraded_views_tell_a_timing_only_if_it_fits_much_better() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)[:4]
    search = begin_search(frames[0])
    for frame in frames[1:]:
        search.add(build_image_pyramid(frame), is_degraded=True)
    found = search.evaluate()
    assert found.is_degraded
    assert not replace(found, score_gain=SUFFICIENT_SEARCH_SCORE_GAIN - 0.1).is_clear
    assert replace(found, score_gain=SUFFICIENT_SEARCH_SCORE_GAIN + 0.1).is_clear


def test_a_bare_wall_does_not_constrain_the_motion() -> None:
    wall = [add_noise(render_view(BRISK, k / 30, (WALL,), paint=0.0), k) for k in range(4)]
    room = swinging_frames(READOUT_S, DELAY_S)[:4]
    for frames, is_well_constrained in ((wall, False), (room, True)):
        search = begin_search(frames[0])
        for frame in frames[1:]:
            search.add(build_image_pyramid(frame))
        assert search.track_with(np.zeros(2)).is_well_constrained == is_well_constrained


def test_a_view_without_the_keyframe_does_not_constrain_the_motion() -> None:
    first = swinging_frames(READOUT_S, DELAY_S)[0]
    search = begin_search(first)
    assert not search.hypotheses[0].is_well_constrained
    search.add(build_image_pyramid(make_empty_frame(first)))
    assert not search.hypotheses[0].is_well_constrained


def test_only_the_uncertain_value_is_searched_for() -> None:
    first = replace(swinging_frames(0.0, 0.0)[0], readout_s=READOUT_S)
    search = begin_search(first, np.array([0.001, 0.01]))
    corrections = np.array([hypothesis.correction for hypothesis in search.hypotheses])
    assert (corrections[:, 0] == 0.0).all()
    assert sorted(corrections[:, 1]) == [-SEARCH_STEPS_S[1], 0.0, SEARCH_STEPS_S[1]]
