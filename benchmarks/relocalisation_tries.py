"""Tries for relocalisation, cut out of the film of a tour: a way, a cover, another place."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.tour_frames import tour_frame
from benchmarks.views_shared import SeenView, most_shared
from benchmarks.virtual_frames import THREADS
from drivers.camera import RgbdFrame
from drivers.geometry import Array
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import Images, Source
from drivers.synthetic.rendering import render_all
from vo_service.terminal import Terminal

# Frames before the cover, covered, and after it.
BEFORE, COVERED, AFTER = 600, 90, 60
# Views are compared every so many frames. A place was seen before if so much of what it shows was,
# and it was not if hardly anything was, in every view of so many frames from the first on.
EVERY = 15
SEEN, UNSEEN = 0.5, 0.02
SEEN_FOR = 30


@dataclass(frozen=True)
class Try:
    """Film frames `first` to `first` + BEFORE, then the camera is covered, then from `back` on.

    `alike` is the frame before the cover that shows most of what is seen at `back`.
    """

    first: int
    back: int
    alike: int

    @property
    def shown(self) -> NDArray[np.int64]:
        """(F,) the frame of the film at each of the try; while covered, that before."""
        before = np.arange(self.first, self.first + BEFORE)
        covered = np.full(COVERED, before[-1])
        return np.concatenate([before, covered, np.arange(self.back, self.back + AFTER)])


def kept_film(folder: Path, config: SyntheticConfig, terminal: Terminal) -> Source:
    """The film of a tour in FOLDER/films, rendered where there is none yet."""
    # A folder of its own for each: a film cache holds no more than one of this length.
    name = f"{'twins' if config.twin_corners else 'tour'}-{config.seed}"
    progress = terminal.counter(f"rendering room {config.seed}: frame")
    sequence = render_all(config, folder / "films" / name, progress, THREADS)

    def images(index: int) -> Images:
        found = sequence.read(index % config.frame_count)
        assert found is not None, "it was rendered"
        return found

    return images


def frames_of(a_try: Try, config: SyntheticConfig, film: Source) -> Iterator[RgbdFrame]:
    """The frames of a try, with stamps that go on evenly."""
    for seq, shown in enumerate(a_try.shown):
        frame = tour_frame(config, seq, film(int(shown)))
        if BEFORE <= seq < BEFORE + COVERED:
            dark = np.zeros_like(frame.colour_bgr), np.zeros_like(frame.depth_raw)
            frame = replace(frame, colour_bgr=dark[0], depth_raw=dark[1])
        yield frame


def views_along(config: SyntheticConfig, film: Source, T_room_camera: Array) -> list[SeenView]:
    """What every EVERY-th frame of the film shows."""
    numbers = range(0, len(T_room_camera), EVERY)
    return [SeenView.of(tour_frame(config, n, film(n)), T_room_camera[n]) for n in numbers]


def choose_tries(
    views: Sequence[SeenView], count: int, unseen: bool, rng: np.random.Generator
) -> list[Try]:
    """Up to `count` tries that come back where it was seen before, or where it was not.

    Fewer where the film has not so many: none of its ways is taken twice.
    """
    fits = _is_unseen if unseen else _is_seen
    span, after = BEFORE // EVERY, AFTER // EVERY
    chosen: list[Try] = []
    for first in rng.permutation(len(views) - span):
        before = views[first : first + span]
        later = np.arange(first + span + COVERED // EVERY, len(views) - after)
        # The later places in any order; the first that fits is taken.
        for back in rng.permutation(later):
            if fits(before, views[back : back + after + 1]):
                alike = first + np.argmax([view.share_of(views[back]) for view in before])
                chosen.append(Try(*(EVERY * int(view) for view in (first, back, alike))))
                break
        if len(chosen) == count:
            break
    return chosen


Fits = Callable[[Sequence[SeenView], Sequence[SeenView]], bool]


def _is_seen(before: Sequence[SeenView], after: Sequence[SeenView]) -> bool:
    first_second = after[: SEEN_FOR // EVERY + 1]
    return all(most_shared(view, before) >= SEEN for view in first_second)


def _is_unseen(before: Sequence[SeenView], after: Sequence[SeenView]) -> bool:
    return all(most_shared(view, before) <= UNSEEN for view in after)
