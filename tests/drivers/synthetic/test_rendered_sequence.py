"""Frames on disk: complete or missing, shared by processes, in a folder of limited size."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core import CameraError, InputError
from drivers.faulty_camera import Fault, FaultKind
from drivers.synthetic import rendered_sequence
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.rendered_sequence import (
    RenderedSequence,
    SequenceFiles,
    create_sequence,
    files_for_config,
)
from drivers.synthetic.sensors import RenderedImages
from tests.drivers.synthetic.conftest import FAULTY

BYTES = 5 * (5 * 4 * 6 + 8)  # of five frames and their index


def files(folder: Path, key: str = "key", count: int = 5) -> SequenceFiles:
    return SequenceFiles(folder, key, count, 4, 6)


def frame(value: int) -> RenderedImages:
    return RenderedImages(
        np.full((4, 6, 3), value, np.uint8), np.full((4, 6), 1000 + value, np.uint16)
    )


def filled(folder: Path, key: str = "key") -> RenderedSequence:
    sequence = create_sequence(files(folder, key))
    for index in range(5):
        sequence.write(index, frame(index))
    return sequence


def test_a_frame_that_one_wrote_is_read_by_another(tmp_path: Path) -> None:
    writer, reader = create_sequence(files(tmp_path)), create_sequence(files(tmp_path))
    assert reader.read(3) is None
    writer.write(3, frame(7))
    assert reader.missing_frames().tolist() == [0, 1, 2, 4]
    images = reader.read(3)
    assert images is not None
    np.testing.assert_array_equal(images.color_bgr, frame(7).color_bgr)
    np.testing.assert_array_equal(images.depth_raw, frame(7).depth_raw)


def test_a_damaged_frame_is_missing_and_the_others_are_not(tmp_path: Path) -> None:
    filled(tmp_path)
    with files(tmp_path).frames.open("r+b") as file:
        file.seek(2 * files(tmp_path).frame_bytes + 5)
        file.write(b"damaged")
    sequence = create_sequence(files(tmp_path))
    assert [sequence.read(index) is None for index in range(5)] == [
        False,
        False,
        True,
        False,
        False,
    ]
    assert sequence.missing_frames().tolist() == [2]


@pytest.mark.parametrize("damage", ["short frames", "short index", "no index", "nonsense index"])
def test_damaged_files_never_give_a_wrong_frame(tmp_path: Path, damage: str) -> None:
    filled(tmp_path)
    frames, index = files(tmp_path).frames, files(tmp_path).index
    if damage == "short frames":
        os.truncate(frames, 100)
    elif damage == "short index":
        os.truncate(index, 12)
    elif damage == "no index":
        index.unlink()
    else:
        index.write_bytes(os.urandom(40))
    sequence = create_sequence(files(tmp_path))
    assert [sequence.read(index) for index in range(5)] == [None] * 5
    assert sequence.missing_frames().tolist() == [0, 1, 2, 3, 4]


def test_the_key_changes_with_the_pixels_and_not_with_injected_faults(tmp_path: Path) -> None:
    track = tmp_path / "track.txt"
    track.write_text("0 0 0 0 0 0 0 1\n")
    others = [
        replace(FAULTY, seed=2),
        replace(FAULTY, motion=MotionKind.STILL),
        replace(FAULTY, track=track),
    ]
    keys = {files_for_config(config, tmp_path).key for config in [FAULTY, *others]}
    assert len(keys) == 4
    with_fault = replace(FAULTY, faults=(Fault(FaultKind.BLACK, 1),))
    assert files_for_config(with_fault, tmp_path).key in keys
    track.write_text("0 0 0 1 0 0 0 1\n")
    assert files_for_config(others[2], tmp_path).key not in keys


def test_the_least_recently_used_sequences_are_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rendered_sequence, "MAX_FOLDER_BYTES", int(2.9 * BYTES))
    for age, key in enumerate(("a", "b")):
        filled(tmp_path, key).close()
        for path in (files(tmp_path, key).frames, files(tmp_path, key).index):
            os.utime(path, (age, age))
    create_sequence(files(tmp_path, "a")).close()
    filled(tmp_path, "c")
    assert {path.stem for path in tmp_path.iterdir()} == {"a", "c"}


def test_a_sequence_that_is_open_stays_readable_when_it_is_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = filled(tmp_path, "a")
    monkeypatch.setattr(rendered_sequence, "MAX_FOLDER_BYTES", int(1.5 * BYTES))
    create_sequence(files(tmp_path, "b"))
    assert not files(tmp_path, "a").frames.exists()
    assert sequence.read(4) is not None


def test_a_full_disk_is_a_clear_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(CameraError, match=r"No space left on device; free some space"):
        create_sequence(files(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_created_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: cannot store frames there"):
        create_sequence(files(tmp_path / "file"))


def test_too_many_frames_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"18000 frames need 27\.6 GB"):
        files_for_config(SyntheticConfig(duration_s=600.0), tmp_path)
