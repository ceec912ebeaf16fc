"""The opening of a folder of images in any known layout."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME, find_calibration
from drivers.core import InputError
from drivers.layouts.color_depth_folders import (
    LISTS,
    is_redwood,
    is_scannet,
    read_redwood,
    read_scannet,
)
from drivers.layouts.contents import FolderContents
from drivers.layouts.frame_files import has_frame_files, read_frame_files
from drivers.layouts.icl_nuim import is_icl_nuim, read_icl_nuim
from drivers.recording.recording import Recording
from drivers.tum.accelerometer import read_accelerometer
from drivers.tum.folder import check_frames, open_tum_folder


@dataclass(frozen=True)
class Layout:
    """A layout: how it is recognized, and how it is read.

    Attributes:
        is_match: Whether a folder has this layout, complete or not.
        read: Reads it. Raises InputError, which says what is missing.
    """

    name: str
    is_match: Callable[[Path], bool]
    read: Callable[[Path], FolderContents]


LAYOUTS = (
    Layout("ICL-NUIM", is_icl_nuim, read_icl_nuim),
    Layout("7-Scenes", has_frame_files, read_frame_files),
    Layout("ScanNet", is_scannet, read_scannet),
    Layout("Redwood", is_redwood, read_redwood),
)


def find_layout(folder: Path) -> Layout | None:
    """Return the layout of a folder; None if it has none of the table, but maybe TUM's."""
    if not folder.is_dir():
        return None
    return next((each for each in LAYOUTS if each.is_match(folder)), None)


def open_folder(folder: Path, camera_file: Path | None) -> Recording:
    """Open a folder of images, and load its first frame.

    Args:
        camera_file: Camera file; None for that of the folder, or the layout's camera.

    Raises:
        InputError: The folder cannot be used.
    """
    layout = find_layout(folder)
    if layout is None:
        _check_not_above(folder)
        return open_tum_folder(folder, camera_file)
    contents = layout.read(folder)
    camera = find_calibration(folder, camera_file, contents.camera)
    depth_camera = contents.depth_camera and (camera.depth or contents.depth_camera)
    unpaired = contents.frames.unpaired
    parts = [*contents.assumptions, *([f"images without a partner: {unpaired}"] * bool(unpaired))]
    file = camera_file or folder / CAMERA_FILE_NAME
    source = f"camera file {file}" if file.exists() else f"that of the layout of {layout.name}"
    recording = Recording(
        path=folder,
        frames=contents.frames,
        calibration=camera,
        ground_truth=contents.ground_truth,
        accelerometer=read_accelerometer(folder),
        depth_camera=depth_camera,
        summary=f"{folder}: layout of {layout.name}: {'; '.join(parts)}",
        intrinsics_source=source,
        depth_unit_source=source,
    )
    return check_frames(recording)


def _check_not_above(folder: Path) -> None:
    """Raise InputError if not the folder, but its subfolders are recordings."""
    if not folder.is_dir() or any((folder / name).exists() for name in LISTS):
        return
    with suppress(OSError):  # opening the folder tells the fault
        below = sorted(each for each in folder.iterdir() if each.is_dir())
        recordings = [each for each in below if find_layout(each) or (each / LISTS[0]).exists()]
        if recordings:
            raise InputError(
                f"{folder}: is no recording, but has {len(recordings)} in it; name one, such as "
                f"{recordings[0]}"
            )
