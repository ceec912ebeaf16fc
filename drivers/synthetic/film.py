"""A film: all frames of a configuration, rendered ahead and then played from memory."""

import hashlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.errors import InputError
from drivers.jit import interruptible
from drivers.synthetic.cache import Film, FilmCache
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import Images, Source
from drivers.synthetic.render import make_renderer

Progress = Callable[[int, int], None]  # frames done, frames in all
LARGEST_FILM_BYTES = 3 << 30


def silent(done: int, total: int) -> None:
    """Progress that nobody watches."""


def load_or_render(
    config: SyntheticConfig, cache_dir: Path | None, progress: Progress, threads: int
) -> Film:
    """The film of `config`: from the cache where it is there and whole, else rendered (and kept).

    What `progress` raises ends it, also between two kernels that are compiled first.
    Raises InputError if it is too long to keep or the track or the folder cannot be used,
    CameraError if the disk is full.
    """
    dtype = film_type(config)

    if cache_dir is None:
        film: Film = np.zeros(config.frame_count, dtype=dtype)
        fill(film, _ready_render(config, progress, threads), threads, progress)
        return film
    cache, key = FilmCache(cache_dir), film_key(config)
    kept = cache.load(key, config.frame_count, dtype)
    if kept is not None:
        return kept
    render = _ready_render(config, progress, threads)
    return cache.make(
        key, config.frame_count, dtype, lambda film: fill(film, render, threads, progress)
    )


def _ready_render(config: SyntheticConfig, progress: Progress, threads: int) -> Source:
    """Renders any frame, with everything compiled that it takes.

    A kernel takes seconds, and cannot be cancelled: no disk space is taken as long as that goes on.
    """

    def check() -> None:
        progress(0, config.frame_count)

    check()
    with interruptible(check):
        render = make_renderer(config, threads).render
        render(0)
    return render


def film_source(film: Film) -> Source:
    """Plays a film round and round."""

    def images(seq: int) -> Images:
        record = film[seq % len(film)]
        return Images(np.asarray(record["colour"]), np.asarray(record["depth"]))

    return images


def film_type(config: SyntheticConfig) -> np.dtype[np.void]:
    """Record type of a frame: `colour` and `depth`.

    Raises InputError if all frames together are too many to keep.
    """
    size = config.camera.height, config.camera.width
    fields: Any = [("colour", np.uint8, (*size, 3)), ("depth", np.uint16, size)]
    dtype: np.dtype[np.void] = np.dtype(fields)
    total = config.frame_count * dtype.itemsize
    if total > LARGEST_FILM_BYTES:
        raise InputError(
            f"synthetic camera: {config.frame_count} frames are {total / 1e9:.1f} GB, at most "
            f"{LARGEST_FILM_BYTES / 1e9:.1f} GB are kept: ask for a shorter duration, or loop"
        )
    return dtype


def film_key(config: SyntheticConfig) -> str:
    """Name of a film: it changes with whatever changes a pixel, the renderer's code included.

    Raises InputError if the track cannot be read.
    """
    digest = hashlib.sha256(repr(replace(config, faults=(), track=None)).encode())
    digest.update(f"{np.__version__} {cv2.__version__}".encode())
    here = Path(__file__).parent
    try:
        for source in sorted([*here.glob("*.py"), *here.parent.glob("*.py")]):
            digest.update(source.read_bytes())
        if config.track is not None:
            digest.update(config.track.read_bytes())
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()[:24]


def fill(film: Film, render: Source, threads: int, progress: Progress) -> None:
    """Render every frame of `film`, several at once; a failure stops the others."""
    stop = threading.Event()

    def one(index: int) -> None:
        if not stop.is_set():
            images = render(index)
            film[index]["colour"], film[index]["depth"] = images.colour, images.depth

    with ThreadPoolExecutor(threads) as pool:
        try:
            for done, _ in enumerate(pool.map(one, range(len(film))), 1):
                progress(done, len(film))
        finally:
            stop.set()
