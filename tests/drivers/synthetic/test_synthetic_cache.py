import errno
import fcntl
import os
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from drivers.background_opening import Cancellable, Cancelled
from drivers.errors import CameraError, InputError
from drivers.synthetic import film as film_module
from drivers.synthetic.cache import Film, FilmCache
from drivers.synthetic.camera import Preparation, SyntheticCamera
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.faults import Fault, FaultKind
from drivers.synthetic.film import film_key, load_or_render, silent

RECORD = np.dtype([("colour", np.uint8, (4, 6, 3)), ("depth", np.uint16, (4, 6))])


def ramp(film: Film) -> None:
    for index in range(len(film)):
        film[index]["colour"], film[index]["depth"] = index, index * 100


def first_frame(config: SyntheticConfig, cache: Path) -> tuple[bytes, int]:
    """Bytes of the first frame, and how many frames were rendered for it."""
    rendered: list[int] = []

    def progress(done: int, total: int) -> None:
        assert total == config.frame_count
        rendered.append(done)

    with SyntheticCamera(
        config, preparation=Preparation(cache_dir=cache, progress=progress)
    ) as camera:
        frame = camera.read(1.0)
    return frame.colour_bgr.tobytes() + frame.depth_raw.tobytes(), max(rendered, default=0)


def test_frames_are_rendered_once_and_again_when_the_file_is_damaged(
    faulty: SyntheticConfig, tmp_path: Path
) -> None:
    config = replace(faulty, duration_s=0.07)
    fresh, rendered = first_frame(config, tmp_path)
    assert rendered == 2
    assert first_frame(config, tmp_path) == (fresh, 0)
    (film,) = tmp_path.glob("*.npy")
    with film.open("r+b") as file:
        file.seek(2000)
        file.write(b"damaged")
    assert first_frame(config, tmp_path) == (fresh, 2)
    assert first_frame(config, tmp_path) == (fresh, 0)


def test_what_changes_a_pixel_changes_the_key_and_faults_on_request_do_not(
    tmp_path: Path, faulty: SyntheticConfig
) -> None:
    track = tmp_path / "track.txt"
    track.write_text("0 0 0 0 0 0 0 1\n")
    others = [
        replace(faulty, seed=2),
        replace(faulty, motion=Motion.STILL),
        replace(faulty, track=track),
    ]
    keys = {film_key(config) for config in [faulty, *others]}
    assert len(keys) == 4
    assert film_key(replace(faulty, faults=(Fault(FaultKind.BLACK, 1),))) in keys
    track.write_text("0 0 0 1 0 0 0 1\n")
    assert film_key(others[2]) not in keys


@pytest.mark.parametrize("damage", ["truncate", "no note", "bad note", "other shape"])
def test_a_film_that_is_not_whole_is_not_played(tmp_path: Path, damage: str) -> None:
    cache = FilmCache(tmp_path)
    cache.make("key", 5, RECORD, ramp)
    film, note = tmp_path / "key.npy", tmp_path / "key.json"
    assert cache.load("key", 5, RECORD) is not None
    if damage == "truncate":
        os.truncate(film, film.stat().st_size - 10)
    elif damage == "no note":
        note.unlink()
    elif damage == "bad note":
        note.write_text("[]")
    assert cache.load("key", 6 if damage == "other shape" else 5, RECORD) is None


def test_the_cache_forgets_what_was_unused_longest(tmp_path: Path) -> None:
    size = 5 * RECORD.itemsize
    cache = FilmCache(tmp_path, largest_bytes=int(2.9 * size))
    for age, key in enumerate(("a", "b")):
        cache.make(key, 5, RECORD, ramp)
        os.utime(tmp_path / f"{key}.npy", (age, age))
    assert cache.load("a", 5, RECORD) is not None
    cache.make("c", 5, RECORD, ramp)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.json",
        "a.npy",
        "c.json",
        "c.npy",
    ]


def test_nothing_stays_behind_when_rendering_fails(tmp_path: Path) -> None:
    def fail(film: Film) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        FilmCache(tmp_path).make("key", 5, RECORD, fail)
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_cleared_and_what_another_renders_is_not(
    tmp_path: Path,
) -> None:
    left, held = tmp_path / "x.1.part", tmp_path / "x.2.part"
    left.write_bytes(b"half")
    with held.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        FilmCache(tmp_path).make("key", 1, RECORD, ramp)
    assert not left.exists()
    assert held.exists()


def test_a_film_that_is_being_rendered_is_held(tmp_path: Path) -> None:
    def make_another(film: Film) -> None:
        FilmCache(tmp_path).make("other", 1, RECORD, ramp)
        ramp(film)

    FilmCache(tmp_path).make("key", 5, RECORD, make_another)
    assert sorted(path.stem for path in tmp_path.glob("*.npy")) == ["key", "other"]


def test_what_another_process_renders_counts(tmp_path: Path) -> None:
    size = 5 * RECORD.itemsize
    cache = FilmCache(tmp_path, largest_bytes=int(2.9 * size))
    cache.make("old", 5, RECORD, ramp)
    with (tmp_path / "x.2.part").open("wb") as file:
        file.truncate(size)
        fcntl.flock(file, fcntl.LOCK_EX)
        cache.make("new", 5, RECORD, ramp)
    assert [path.stem for path in tmp_path.glob("*.npy")] == ["new"]


def test_no_space_is_taken_before_the_renderer_is_ready(
    faulty: SyntheticConfig, tmp_path: Path
) -> None:
    taken: list[tuple[int, list[Path]]] = []

    def progress(done: int, total: int) -> None:
        taken.append((done, list(tmp_path.iterdir())))
        if done:
            raise Cancelled

    with pytest.raises(Cancelled):
        load_or_render(faulty, tmp_path, progress, 1)
    assert all(not paths for done, paths in taken if done == 0)
    assert taken[0] == (0, [])
    assert len(taken[-1][1]) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_rendering_is_cancelled_between_two_kernels(
    faulty: SyntheticConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    cancellable = Cancellable(silent)
    double = numba.njit(lambda x: 2 * x)

    def make_renderer(config: SyntheticConfig, threads: int) -> None:
        cancellable.is_cancelled.set()
        double(1)

    monkeypatch.setattr(film_module, "make_renderer", make_renderer)
    with pytest.raises(Cancelled):
        load_or_render(faulty, None, cancellable, 1)
    assert double.signatures == []


def test_a_full_disk_is_a_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(CameraError, match=r"No space left on device; free some space"):
        FilmCache(tmp_path).make("key", 5, RECORD, ramp)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_the_user_s_mistake(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: frames cannot be kept there"):
        FilmCache(tmp_path / "file").make("key", 5, RECORD, ramp)
