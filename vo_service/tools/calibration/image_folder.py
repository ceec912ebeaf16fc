"""Snapshots from a folder: a recording in TUM format, or nothing but photographs."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME, find_calibration
from drivers.core.errors import InputError
from drivers.tum.decode import UnreadableFrameError, load_color, load_depth
from drivers.tum.folder import read_frame_pairs
from drivers.tum.index_files import read_image_list
from vo_service.tools.calibration.snapshot import NO_DEPTH, Snapshot

SUFFIXES = (".png", ".jpg", ".jpeg")
MILLIMETER_DEPTH_FACTOR = 1000.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SnapshotFiles:
    """One snapshot's files; `depth` is None where it is not wanted."""

    stamp_s: float
    color: Path
    depth: Path | None


@dataclass(frozen=True)
class DepthUnits:
    """What a recording's camera file knows that a board cannot tell."""

    depth_factor: float
    readout_s: float = 0.0
    depth_offset_s: float = 0.0


def list_snapshot_files(folder: Path, with_depth: bool) -> list[SnapshotFiles]:
    """What a folder holds, in order of time; photographs without a list are a second apart.

    Raises InputError if there is nothing, or a list is wrong.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; check the path")
    if (folder / "associations.txt").exists() or with_depth:
        pairs = read_frame_pairs(folder).pairs
        return [
            SnapshotFiles(p.color.stamp_s, p.color.file, p.depth.file if with_depth else None)
            for p in pairs
        ]
    if (folder / "rgb.txt").exists():
        listed = read_image_list(folder / "rgb.txt")
        return [SnapshotFiles(image.stamp_s, image.file, None) for image in listed]
    return [SnapshotFiles(float(n), file, None) for n, file in enumerate(_list_photographs(folder))]


def _list_photographs(folder: Path) -> list[Path]:
    for place in (folder, folder / "rgb"):
        found = [file for file in place.glob("*") if file.suffix.lower() in SUFFIXES]
        if found:
            return sorted(found)
    raise InputError(
        f"{folder}: holds no images; name a recording (rgb.txt), or a folder of PNG or JPEG images "
        "of the board"
    )


def read_snapshots(files: list[SnapshotFiles]) -> Iterator[Snapshot | None]:
    """One a file; None where an image cannot be read, which the log then names.

    Raises InputError if images differ in size: they are not of one camera.
    """
    first: Snapshot | None = None
    for each in files:
        try:
            depth = NO_DEPTH if each.depth is None else load_depth(each.depth)
            found = Snapshot(str(each.color), each.stamp_s, load_color(each.color), depth)
        except UnreadableFrameError as error:
            _log.warning("an image is left out: %s", error)
            yield None
            continue
        first = first or found
        _check_size(found, first)
        yield found


def _check_size(found: Snapshot, first: Snapshot) -> None:
    if found.size != first.size or found.depth_raw.shape != first.depth_raw.shape:
        raise InputError(
            f"{found.name}: is {_format_size(found)}, but {first.name} is {_format_size(first)}; calibrate from "
            "images of one camera at one size"
        )


def _format_size(snapshot: Snapshot) -> str:
    color = "{}x{}".format(*snapshot.size)
    height, width = snapshot.depth_raw.shape
    return f"{color} (depth {width}x{height})" if width else color


def read_depth_units(folder: Path, given: Path | None) -> DepthUnits:
    """From the camera file `given` or the folder's own; else millimetres, as a sensor gives them.

    Raises InputError if there is such a file and it is wrong.
    """
    try:
        camera = find_calibration(folder, given)
    except InputError:
        if given is not None or (folder / CAMERA_FILE_NAME).exists():
            raise
        return DepthUnits(MILLIMETER_DEPTH_FACTOR)
    return DepthUnits(camera.depth_factor, camera.readout_s, camera.depth_offset_s)
