"""Renders sequences of the virtual Kinect as TUM folders, several at a time."""

import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import cv2

from benchmarks.camera_frames import read_all_frames
from drivers.camera import PlaybackMode
from drivers.core.errors import InputError
from drivers.synthetic.camera import RenderOptions, SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.writer import TumWriter

# The configuration of a folder; a folder without this file is incomplete or not ours.
CONFIG_RECORD = "synthetic.txt"


def render_all(
    sequences: Mapping[Path, SyntheticConfig], print_line: Callable[[str], None], processes: int
) -> None:
    """Render missing sequences and those of another configuration.

    An interrupted sequence is rendered again the next time.

    Args:
        sequences: The configuration of each folder.
        print_line: Prints progress.
        processes: Rendering processes.

    Raises:
        InputError: A folder has other contents, or a track cannot be used.
        UserFacingError: The disk is full.
    """
    missing = {
        folder: config for folder, config in sequences.items() if not is_complete(folder, config)
    }
    if not missing:
        return
    spawn = get_context("spawn")
    with ProcessPoolExecutor(
        processes, spawn, initializer=cv2.setNumThreads, initargs=(1,)
    ) as pool:
        futures = {
            pool.submit(render, folder, config): folder for folder, config in missing.items()
        }
        try:
            for count, future in enumerate(as_completed(futures), 1):
                future.result()
                print_line(f"rendered {count} of {len(missing)}: {futures[future]}")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def is_complete(folder: Path, config: SyntheticConfig) -> bool:
    """Whether a folder has the complete sequence of this configuration."""
    record = folder / CONFIG_RECORD
    return record.is_file() and record.read_text() == f"{config}\n"


def render(folder: Path, config: SyntheticConfig) -> None:
    """Render one sequence. Raises as `render_all`."""
    if folder.exists():
        if not (folder / CONFIG_RECORD).is_file():
            raise InputError(f"{folder}: was not written by this program; name another folder")
        shutil.rmtree(folder)
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    once = replace(config, loop=False)
    with SyntheticCamera(once, PlaybackMode.LOCKSTEP, RenderOptions(threads=1)) as camera:
        _write(camera, part)
    (part / CONFIG_RECORD).write_text(f"{config}\n")
    part.rename(folder)


def _write(camera: SyntheticCamera, folder: Path) -> None:
    with TumWriter(folder, ground_truth=camera.ground_truth) as writer:
        for frame in read_all_frames(camera):
            writer.write(frame)
