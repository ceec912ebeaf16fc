"""A recording that methods are compared on."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory, has_match, nearest_indices
from drivers.tum.folder import TumFolder, open_tum_folder
from vo_service.tools.benchmark.frame_selection import ALL_FRAMES, FrameSelection
from vo_service.tools.evaluation.gaps import Gap, find_gaps


@dataclass(frozen=True)
class BenchmarkRecording:
    """A folder that has been checked, or an excerpt of it, with a name of its own.

    camera_file  what it was opened with
    opened       its frames are those of the excerpt
    """

    name: str
    folder: Path
    camera_file: Path | None
    tum_folder: TumFolder
    frame_selection: FrameSelection = ALL_FRAMES

    def select(self, frame_selection: FrameSelection) -> "BenchmarkRecording":
        """An excerpt of the whole recording."""
        frames = self.tum_folder.frames
        part = replace(frames, pairs=frame_selection.select(frames.pairs))
        opened = replace(self.tum_folder, frames=part)
        return replace(
            self,
            name=f"{self.name}{frame_selection.suffix}",
            frame_selection=frame_selection,
            tum_folder=opened,
        )

    @cached_property
    def frame_stamps_s(self) -> Array:
        """(F,) stamps of the frames that it lists."""
        return np.array([pair.color.stamp_s for pair in self.tum_folder.frames.pairs])

    @cached_property
    def gaps(self) -> list[Gap]:
        """Pauses between its frames."""
        return find_gaps(self.frame_stamps_s)

    @property
    def truth(self) -> Trajectory | None:
        """The ground truth, where it has one."""
        return self.tum_folder.ground_truth

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return float(self.frame_stamps_s[-1] - self.frame_stamps_s[0])

    @property
    def path_m(self) -> float | None:
        """Length of the true way, from frame to frame; None where it is not known."""
        if self.truth is None:
            return None
        known_s = self.frame_stamps_s[has_match(self.frame_stamps_s, self.truth.stamps_s)]
        if len(known_s) < 2:
            return None
        positions_m = self.truth.T_world_camera[
            nearest_indices(self.truth.stamps_s, known_s), :3, 3
        ]
        return float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())


def open_recordings(folders: Sequence[Path], camera_file: Path | None) -> list[BenchmarkRecording]:
    """Check the folders before hours go into them; `camera_file` as for `open_tum_folder`.

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
        BenchmarkRecording(name, folder, camera_file, open_tum_folder(folder, camera_file))
        for name, folder in zip(names, folders, strict=True)
    ]
