"""A recording that methods are compared on."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.geometry import Array
from drivers.trajectory import StampedPoses, has_partner, nearest
from drivers.tum.folder import TumFolder, open_folder
from vo_service.evaluation.gaps import Gap, find_gaps
from vo_service.runs.excerpt import WHOLE, Excerpt


@dataclass(frozen=True)
class Recording:
    """A folder that has been checked, or an excerpt of it, with a name of its own.

    camera_file  what it was opened with
    opened       its frames are those of the excerpt
    """

    name: str
    folder: Path
    camera_file: Path | None
    opened: TumFolder
    excerpt: Excerpt = WHOLE

    def only(self, excerpt: Excerpt) -> "Recording":
        """An excerpt of the whole recording."""
        frames = self.opened.frames
        part = replace(frames, pairs=excerpt.of(frames.pairs))
        opened = replace(self.opened, frames=part)
        return replace(self, name=f"{self.name}{excerpt.suffix}", excerpt=excerpt, opened=opened)

    @cached_property
    def frames_s(self) -> Array:
        """(F,) stamps of the frames that it lists."""
        return np.array([pair.colour.stamp_s for pair in self.opened.frames.pairs])

    @cached_property
    def gaps(self) -> list[Gap]:
        """Pauses between its frames."""
        return find_gaps(self.frames_s)

    @property
    def truth(self) -> StampedPoses | None:
        """The ground truth, where it has one."""
        return self.opened.ground_truth

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return float(self.frames_s[-1] - self.frames_s[0])

    @property
    def path_m(self) -> float | None:
        """Length of the true way, from frame to frame; None where it is not known."""
        if self.truth is None:
            return None
        known_s = self.frames_s[has_partner(self.frames_s, self.truth.stamps_s)]
        if len(known_s) < 2:
            return None
        positions_m = self.truth.T_world_camera[nearest(self.truth.stamps_s, known_s), :3, 3]
        return float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())


def open_recordings(folders: Sequence[Path], camera_file: Path | None) -> list[Recording]:
    """Check the folders before hours go into them; `camera_file` as for `open_folder`.

    Raises InputError for a folder without use, and for two of one name: results are kept by name.
    """
    names = [folder.resolve().name for folder in folders]
    for name, count in Counter(names).items():
        if count > 1:
            twice = [str(folder) for folder in folders if folder.resolve().name == name]
            raise InputError(
                f"{' and '.join(twice)}: results are kept by the folder's name, and these have the "
                "same; rename one, or compare them one at a time, each with an --output of its own"
            )
    return [
        Recording(name, folder, camera_file, open_folder(folder, camera_file))
        for name, folder in zip(names, folders, strict=True)
    ]
