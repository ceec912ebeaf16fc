"""The order in which frames are rendered."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.synthetic.render_worker import RenderSchedule
from drivers.synthetic.rendered_sequence import RenderedSequence, SequenceFiles, create_sequence
from drivers.synthetic.sensors import RenderedImages

FRAME = RenderedImages(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.uint16))


class Renderers:
    """Renders the frames of a schedule, each in `render_s` of its own clock."""

    def __init__(self, sequence: RenderedSequence, rate_hz: float, render_s: float) -> None:
        self.now_s = 100.0
        self._sequence, self._render_s = sequence, render_s
        self.schedule = RenderSchedule(sequence, rate_hz, lambda: self.now_s)

    def render(self) -> int | None:
        index = self.schedule.next_frame()
        if index is not None:
            self.now_s += self._render_s
            self._sequence.write(index, FRAME)
            self.schedule.mark_rendered(index)
        return index


@pytest.fixture
def sequence(tmp_path: Path) -> Iterator[RenderedSequence]:
    """A hundred frames, none of them rendered."""
    created = create_sequence(SequenceFiles(tmp_path, "key", 100, 2, 2))
    yield created
    created.close()


def test_a_reader_that_waits_gets_all_frames_in_order(sequence: RenderedSequence) -> None:
    renderers = Renderers(sequence, rate_hz=0.0, render_s=5.0)
    assert [renderers.render() for _ in range(101)] == [*range(100), None]


def test_a_live_reader_finds_frames_that_were_ready_in_time(sequence: RenderedSequence) -> None:
    """At 10 frames per second and 0.35 s for each, about every fourth frame is ready in time."""
    renderers = Renderers(sequence, rate_hz=10.0, render_s=0.35)
    renderers.render()
    begin_s = renderers.now_s
    renderers.schedule.set_reader_position(0)
    for _ in range(20):
        index = renderers.render()
        assert index is not None
        due = (renderers.now_s - begin_s) * 10.0
        assert due - 1.01 <= index <= due + 1.01


def test_frames_that_were_passed_over_are_rendered_when_none_is_urgent(
    sequence: RenderedSequence,
) -> None:
    renderers = Renderers(sequence, rate_hz=10.0, render_s=0.01)
    renderers.schedule.set_reader_position(98)
    assert [renderers.render() for _ in range(4)] == [98, 99, 0, 1]


def test_a_frame_that_the_reader_waits_for_comes_first_and_once(sequence: RenderedSequence) -> None:
    renderers = Renderers(sequence, rate_hz=0.0, render_s=1.0)
    for index in (50, 50, 7):
        renderers.schedule.add_urgent(index)
    assert [renderers.render() for _ in range(3)] == [50, 7, 0]


def test_two_threads_never_render_the_same_frame(sequence: RenderedSequence) -> None:
    schedule = RenderSchedule(sequence, 0.0)
    assert [schedule.next_frame() for _ in range(100)] == list(range(100))
    assert schedule.next_frame() is None
