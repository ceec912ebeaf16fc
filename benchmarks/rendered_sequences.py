"""Sequences of the virtual Kinect as TUM folders: rendered once, several at a time."""

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

# Says what a folder was rendered from: one without it is not whole, or somebody else's.
CONFIG_RECORD = "synthetic.txt"


def render_all(
    wanted: Mapping[Path, SyntheticConfig], print_line: Callable[[str], None], processes: int
) -> None:
    """Render what is not there yet, and what was rendered from another configuration.

    The one cut off is begun again the next time. Raises InputError for a folder that holds anything
    else, or a track that cannot be used, and UserFacingError if the disk is full.
    """
    missing = {
        folder: config for folder, config in wanted.items() if not is_complete(folder, config)
    }
    if not missing:
        return
    spawn = get_context("spawn")
    with ProcessPoolExecutor(
        processes, spawn, initializer=cv2.setNumThreads, initargs=(1,)
    ) as pool:
        begun = {pool.submit(render, folder, config): folder for folder, config in missing.items()}
        try:
            for done, ended in enumerate(as_completed(begun), 1):
                ended.result()
                print_line(f"rendered {done} of {len(missing)}: {begun[ended]}")
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def is_complete(folder: Path, config: SyntheticConfig) -> bool:
    """Whether a folder holds all of this very sequence."""
    note = folder / CONFIG_RECORD
    return note.is_file() and note.read_text() == f"{config}\n"


def render(folder: Path, config: SyntheticConfig) -> None:
    """One sequence, once from its begin to its end. Raises as `render_all`."""
    if folder.exists():
        if not (folder / CONFIG_RECORD).is_file():
            raise InputError(f"{folder}: was not rendered here; name another folder")
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
