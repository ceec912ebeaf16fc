"""Whether to believe an alignment, by what it rests on."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.geometry import Array
from tests.vo_service.odometry.keyframe.rolling_views import noisy, seen
from vo_service.odometry.keyframe import measure, system
from vo_service.odometry.keyframe import readings as columns
from vo_service.odometry.keyframe.alignment import (
    STANDING,
    Alignment,
    align,
    all_alike,
    depth_alone,
)
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.confidence import agrees, cover, doubt, lack, misfit, oddness
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.points import find_points

POINTS = find_points(make_images(noisy(seen(), 0)), at_rest(), ALL_STILL)
GOOD = align(POINTS, make_images(noisy(seen(), 1)), [np.eye(4)], STANDING, (1.0, 0.0), all_alike())


def counted(**counts: float) -> Alignment:
    changed = GOOD.counts.copy()
    for name, value in counts.items():
        changed[getattr(measure, name)] = value
    return replace(GOOD, counts=changed)


def fitted(**fit: float) -> Alignment:
    changed = GOOD.fit.copy()
    for name, value in fit.items():
        changed[getattr(system, name)] = value
    return replace(GOOD, fit=changed)


def test_a_good_alignment_is_believed_and_lacks_nothing() -> None:
    assert doubt(GOOD) == lack(GOOD) == ""
    assert agrees(GOOD.counts)
    assert oddness(GOOD) < 1.0


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (counted(IN_IMAGE=40), "40 of "),
        (counted(DISREGARDED=0.9 * GOOD.counts[measure.IN_IMAGE]), "90 % of the view does not fit"),
        (counted(DEPTH_AGREES=0), "depths agree with the keyframe's"),
        (counted(BRIGHTNESS_AGREES=0), "brightnesses agree with the keyframe's"),
        (counted(WITH_DEPTH=0, WITH_BRIGHTNESS=9), "only 9 readings"),
        (fitted(SIGMA_DEPTH=1.0), "the depth does not fit"),
        (fitted(SIGMA_BRIGHTNESS=100.0), "the brightness does not fit"),
        (fitted(GAIN=9.0), "the light is quite another than the keyframe's"),
    ],
)
def test_what_does_not_fit_is_doubted_and_said(found: Alignment, reason: str) -> None:
    assert reason in doubt(found)


def test_brightness_that_does_not_count_is_not_doubted() -> None:
    dark = replace(fitted(SIGMA_BRIGHTNESS=100.0, GAIN=9.0), weights=depth_alone())
    assert doubt(dark) == ""
    assert oddness(dark) < 1.0 < oddness(fitted(SIGMA_BRIGHTNESS=100.0))


def test_what_it_has_to_do_without_is_said() -> None:
    assert "depth alone" in lack(counted(WITH_BRIGHTNESS=0))
    assert "brightness alone" in lack(counted(WITH_DEPTH=0))


def count_of(readings: Array) -> Array:
    return measure.count(POINTS[0], readings, GOOD.fit, all_alike())


def test_readings_are_counted_by_what_they_say() -> None:
    counts = count_of(GOOD.readings)
    assert counts[measure.IN_IMAGE] == np.count_nonzero(GOOD.readings[:, columns.CELL] >= 0)
    assert 0.9 * counts[measure.WITH_DEPTH] < counts[measure.DEPTH_AGREES]
    assert 0.9 * counts[measure.WITH_BRIGHTNESS] < counts[measure.BRIGHTNESS_AGREES]
    assert counts[measure.DISREGARDED] == 0


def test_a_hidden_point_is_not_counted_and_one_seen_through_disagrees() -> None:
    before, within = count_of(GOOD.readings), GOOD.readings[:, columns.CELL] < 16
    hidden, through = GOOD.readings.copy(), GOOD.readings.copy()
    for readings, sign in ((hidden, columns.HIDDEN), (through, -columns.HIDDEN)):
        readings[within, columns.OTHER] = sign
        readings[within, columns.BRIGHTNESS] = readings[within, columns.DEPTH] = np.nan
    assert count_of(hidden)[measure.IN_IMAGE] < before[measure.IN_IMAGE]
    assert agrees(count_of(hidden))
    assert count_of(hidden)[measure.COST] < before[measure.COST]
    assert count_of(through)[measure.IN_IMAGE] == before[measure.IN_IMAGE]
    assert count_of(through)[measure.DEPTH_AGREES] < 0.8 * before[measure.DEPTH_AGREES]
    assert count_of(through)[measure.COST] > before[measure.COST]


def test_points_agree_if_both_their_brightness_and_their_depth_do() -> None:
    agreeing = measure.is_agreeing(POINTS[0], GOOD.readings, GOOD.fit)
    assert agreeing.mean() > 0.85
    for column, by in ((columns.BRIGHTNESS, 200.0), (columns.DEPTH, 0.05)):
        wrong = GOOD.readings.copy()
        wrong[::2, column] += by
        now = measure.is_agreeing(POINTS[0], wrong, GOOD.fit)
        assert now[::2].mean() < 0.3
        np.testing.assert_array_equal(now[1::2], agreeing[1::2])


def covered(share: float) -> Alignment:
    readings = GOOD.readings.copy()
    readings[: int(share * len(readings)), columns.OTHER] = columns.HIDDEN
    return replace(GOOD, readings=readings, counts=count_of(readings))


def test_a_view_that_something_covers_is_not_believed_however_well_the_rest_fits() -> None:
    assert cover(GOOD) == cover(covered(0.4)) == ""
    assert "of the view is covered" in cover(covered(0.7))
    assert doubt(covered(0.7)) == ""
    unfit = counted(DISREGARDED=0.7 * GOOD.counts[measure.IN_IMAGE])
    assert cover(unfit) == "70 % of the view is covered"


def test_a_view_that_is_covered_in_part_is_told() -> None:
    assert lack(covered(0.1)) == ""
    assert "of the view is covered" in lack(covered(0.4))


def test_what_fits_badly_all_over_is_worse_than_what_fits_but_for_a_corner() -> None:
    in_image = GOOD.counts[measure.IN_IMAGE]
    all_over = fitted(SIGMA_BRIGHTNESS=5.0 * GOOD.fit[system.SIGMA_BRIGHTNESS])
    but_for_a_corner = counted(DISREGARDED=0.15 * in_image)
    assert oddness(but_for_a_corner) > oddness(all_over)
    assert misfit(GOOD) < misfit(but_for_a_corner) < misfit(all_over)


def test_what_disregards_half_of_the_view_does_not_fit_better_for_it() -> None:
    half = counted(DISREGARDED=0.5 * GOOD.counts[measure.IN_IMAGE])
    better = 0.6 * GOOD.fit[[system.SIGMA_BRIGHTNESS, system.SIGMA_DEPTH]]
    assert misfit(replace(half, fit=np.array([1.0, 0.0, *better]))) > misfit(GOOD)
