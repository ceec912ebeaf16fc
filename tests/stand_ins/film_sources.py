"""Where the frames of a film come from: a recorded folder, or any camera of ours."""

from collections.abc import Iterator
from itertools import chain, count, islice
from pathlib import Path

import numpy as np

from drivers.camera import EndOfStream, RgbdCamera
from drivers.tum.decode import load_pair
from drivers.tum.folder import open_folder
from tests.stand_ins.depth_scale import fitted_scale
from tests.stand_ins.wire_film import ColourBgr, DepthMm, WireFilm, wire_film

MOST_MM = 65535
FRAMES_TO_FIT = 30


def fitted_film(folder: Path, frames: Iterator[tuple[ColourBgr, DepthMm]]) -> WireFilm:
    """Write a film for a Kinect with the constants of the one that recorded the frames.

    Played on another Kinect, all depth would move by up to half a step of its grid.
    """
    first = list(islice(frames, FRAMES_TO_FIT))
    scale = fitted_scale(depth_mm for _, depth_mm in first)
    return wire_film(folder, chain(first, frames), scale=scale)


def folder_frames(
    folder: Path, camera_file: Path | None = None, most: int | None = None
) -> Iterator[tuple[ColourBgr, DepthMm]]:
    """The images of a TUM folder as they were recorded, lens distortion and all.

    Who plays them gives the folder's camera file to the program that is to see them. Raises
    InputError for a folder without use, UnreadableFrameError for a broken image.
    """
    opened = open_folder(folder, camera_file)
    camera = opened.camera_file
    for pair in opened.frames.pairs[:most]:
        bgr, depth = load_pair(pair, (camera.width, camera.height))
        yield bgr, _millimetres(depth, camera.depth_factor)


def camera_frames(
    camera: RgbdCamera, most: int | None = None
) -> Iterator[tuple[ColourBgr, DepthMm]]:
    """The frames of a camera that delivers in lockstep, until it ends or `most` have come."""
    with camera:
        for seq in count():
            if seq == most:
                return
            try:
                frame = camera.read(timeout_s=100)
            except EndOfStream:
                return
            yield frame.colour_bgr, _millimetres(frame.depth_raw, frame.depth_factor)


def _millimetres(depth_raw: DepthMm, depth_factor: float) -> DepthMm:
    if depth_factor == 1000.0:
        return depth_raw
    depth_mm = np.rint(depth_raw * (1000.0 / depth_factor))
    return np.where(depth_mm <= MOST_MM, depth_mm, 0.0).astype(np.uint16)
