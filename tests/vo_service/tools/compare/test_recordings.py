"""Runs on a selection of a recording's frames."""

from pathlib import Path

import numpy as np
import pytest

from drivers.core import InputError
from tests.drivers.bag.bag_maker import BagWriter
from tests.drivers.bag.test_bag import make_bag, write_frame
from tests.vo_service.tools.compare.sample_runs import make_recording
from vo_service.tools.compare.recordings import ALL_FRAMES, FrameSelection, open_recordings


@pytest.mark.parametrize(
    ("selection", "used", "suffix"),
    [
        (ALL_FRAMES, list(range(8)), ""),
        (FrameSelection(step=3), [0, 3, 6], "-every-3"),
        (FrameSelection(max_frames=5), [0, 1, 2, 3, 4], "-first-5"),
        (FrameSelection(step=2, max_frames=3), [0, 2], "-first-3-every-2"),
        (FrameSelection(step=100), [0], "-every-100"),
    ],
)
def test_every_nth_of_the_first_frames_is_used(
    selection: FrameSelection, used: list[int], suffix: str
) -> None:
    assert selection.select(range(8)) == used
    assert selection.suffix == suffix


def test_a_selection_has_its_own_name_and_frames_and_the_same_truth() -> None:
    whole = make_recording("walk")
    selected = whole.select(FrameSelection(step=10))
    assert selected.name == "walk-every-10"
    np.testing.assert_array_equal(selected.frame_stamps_s, whole.frame_stamps_s[::10])
    assert selected.truth is whole.truth
    assert whole.select(ALL_FRAMES).name == "walk"


def test_a_recording_whose_clock_was_set_back_is_refused(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k, k if k < 20 else k - 3000)

    path = make_bag(tmp_path / "jump.bag", fill, "bag", count=40)
    with pytest.raises(InputError, match="its clock was set back, so methods cannot be compared"):
        open_recordings([path], None)
