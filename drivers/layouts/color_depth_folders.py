"""Folders ``color/`` and ``depth/`` of numbered images: ScanNet's export, Redwood and Open3D."""

import json
import re
from decimal import Decimal
from pathlib import Path

import numpy as np

from drivers.calibration import NO_DISTORTION, CameraCalibration
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory
from drivers.core.input_files import read_input_text
from drivers.core.trajectory_files import read_trajectory_file
from drivers.layouts.contents import (
    AT_30_HZ,
    FolderContents,
    find_numbered_files,
    make_camera,
    make_image,
    pair_numbered,
    read_image_size,
    read_matrix,
    read_pose_files,
)
from drivers.layouts.frame_files import same_place_depth_camera
from drivers.recording.pairing import pair_images
from drivers.recording.recorded_frames import RecordedFrames

# Also Redwood's 3D scans, whose names end in microseconds: 0000001-000000033369.jpg.
IMAGE_PATTERN = r"(\d{1,9})(?:-\d{1,18})?\.(?:png|jpe?g|pgm|tiff?)"
COLOR_FOLDERS = ("color", "colors", "image", "rgb")
DEPTH_FOLDER = "depth"
LISTS = ("rgb.txt", "depth.txt", "associations.txt")
# PrimeSense's defaults, which Redwood and Open3D use for all their sensors.
PRIMESENSE_CAMERA = CameraCalibration(640, 480, 525.0, 525.0, 319.5, 239.5, NO_DISTORTION, 1000.0)
SCANNET_COLOR_INTRINSICS = Path("intrinsic/intrinsic_color.txt")
SCANNET_DEPTH_INTRINSICS = Path("intrinsic/intrinsic_depth.txt")


def is_scannet(folder: Path) -> bool:
    """Whether there are color images, and ScanNet's folder of intrinsics or of poses."""
    has_parts = (folder / "intrinsic").is_dir() or (folder / "pose").is_dir()
    return has_parts and bool(find_numbered_files(folder / "color", IMAGE_PATTERN))


def read_scannet(folder: Path) -> FolderContents:
    """Read the folders color, depth, pose and intrinsic."""
    color = find_numbered_files(folder / "color", IMAGE_PATTERN)
    frames = pair_numbered(folder, color, find_numbered_files(folder / DEPTH_FOLDER, IMAGE_PATTERN))
    K_color, K_depth = (
        _read_intrinsics(folder / name)
        for name in (SCANNET_COLOR_INTRINSICS, SCANNET_DEPTH_INTRINSICS)
    )
    first = frames.pairs[0]
    camera = make_camera(K_color, read_image_size(make_image(first.color.file, Decimal(0))), 1000.0)
    depth_size = read_image_size(make_image(first.depth.file, Decimal(0)), is_depth=True)
    truth, invalid = read_pose_files(find_numbered_files(folder / "pose", r"(\d{1,9})\.txt"))
    skipped = (f"frames without a pose: {invalid}",) if invalid else ()
    assumptions = ("cameras of intrinsic/", "depth in millimeters", AT_30_HZ, *skipped)
    return FolderContents(
        frames, camera, truth, assumptions, same_place_depth_camera(camera, K_depth, depth_size)
    )


def _read_intrinsics(file: Path) -> Array:
    if not file.exists():
        raise InputError(
            f"{file}: no such file; export ScanNet's .sens with --export_intrinsics, or restore it"
        )
    return read_matrix(file)


def is_redwood(folder: Path) -> bool:
    """Whether there are numbered color images in a folder of their own, without TUM's lists."""
    return _find_color(folder) is not None and not any((folder / name).exists() for name in LISTS)


def read_redwood(folder: Path) -> FolderContents:
    """Read the images, the trajectory and, if there is one, Open3D's camera in JSON."""
    color_folder = _find_color(folder) or folder
    color = find_numbered_files(color_folder, IMAGE_PATTERN)
    depth = find_numbered_files(folder / DEPTH_FOLDER, IMAGE_PATTERN)
    if not depth:
        raise InputError(
            f"{folder / DEPTH_FOLDER}: no numbered images, as in {color_folder.name}/; the layout "
            "of Redwood and Open3D needs both folders, that of TUM rgb.txt and depth.txt"
        )
    frames, timing = _pair(folder, color, depth)
    camera, source = _find_camera(folder)
    truth, truth_source = _find_trajectory(folder, frames)
    assumptions = (source, "depth in millimeters", timing, *truth_source)
    return FolderContents(frames, camera, truth, assumptions)


def _find_color(folder: Path) -> Path | None:
    found = (folder / name for name in COLOR_FOLDERS)
    return next((each for each in found if find_numbered_files(each, IMAGE_PATTERN)), None)


def _pair(
    folder: Path, color: dict[int, Path], depth: dict[int, Path]
) -> tuple[RecordedFrames, str]:
    """Pair images by number, or by the stamps in their names.

    Some recordings number their images from 1, but their poses from 0.
    """
    if not all("-" in file.stem for file in [*color.values(), *depth.values()]):
        first = min(color)
        numbered = [{n - first: file for n, file in each.items()} for each in (color, depth)]
        return pair_numbered(folder, *numbered), AT_30_HZ
    images = [
        [make_image(file, Decimal(file.stem.split("-")[1]).scaleb(-6)) for file in files.values()]
        for files in (color, depth)
    ]
    frames = pair_images(*(sorted(each, key=lambda image: image.stamp) for each in images))
    if not frames.pairs:
        raise InputError(f"{folder}: no color and depth images within 20 ms by their names")
    return frames, "stamps in the names of the images"


def _find_camera(folder: Path) -> tuple[CameraCalibration, str]:
    files = sorted(each for each in folder.glob("*.json") if re.search("intrinsic", each.name))
    if not files:
        return PRIMESENSE_CAMERA, "the camera of PrimeSense (assumed): 525 525 319.5 239.5"
    text = read_input_text(files[0], "restore it, or give a camera file")
    try:
        parsed = json.loads(text)
        size = (int(parsed["width"]), int(parsed["height"]))
        K = np.array(parsed["intrinsic_matrix"], np.float64).reshape(3, 3).T  # column by column
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{files[0]}: is not a camera of Open3D, with width, height and intrinsic_matrix; "
            "restore it, or give a camera file"
        ) from error
    return make_camera(K, size, 1000.0), f"the camera of {files[0].name}"


def _find_trajectory(
    folder: Path, frames: RecordedFrames
) -> tuple[Trajectory | None, tuple[str, ...]]:
    patterns = ("trajectory.log", "*trajectory.log", "*-traj.txt")
    file = next((each for name in patterns for each in sorted(folder.glob(name))), None)
    if file is None:
        return None, ()
    return read_trajectory_file(file, frames.stamps_s).poses, (f"true poses {file.name}",)
