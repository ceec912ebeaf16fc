"""Faults of the frames of any camera, here of a recording."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import CameraCounters, RgbdFrame
from drivers.faulty_camera import Fault, FaultKind, FaultyCamera
from drivers.playback.camera import RecordingCamera

ReadFrames = Callable[..., list[RgbdFrame]]
IMAGES = ("color_bgr", "depth_raw")


@pytest.fixture
def read_frames(make_folder: Callable[..., Path]) -> ReadFrames:
    """Read six frames with faults."""
    folder = make_folder(count=6)

    def read(*faults: Fault) -> list[RgbdFrame]:
        with FaultyCamera(RecordingCamera(folder), faults, seed=1) as camera:
            return list(camera)

    return read


def test_without_faults_it_is_the_other_camera(make_folder: Callable[..., Path]) -> None:
    folder = make_folder()
    other = RecordingCamera(folder)
    with FaultyCamera(other, (Fault(FaultKind.DROPPED, 2, 2),), seed=1) as camera:
        assert [frame.seq for frame in camera] == [0, 1, 4]
        assert camera.counters == CameraCounters(delivered=3, skipped=2)
    names = ("name", "clock", "status", "frame_count", "intrinsics_source", "depth_unit_source")
    assert all(getattr(camera, name) == getattr(other, name) for name in names)


def test_a_frozen_camera_repeats_its_last_images(read_frames: ReadFrames) -> None:
    frames = read_frames(Fault(FaultKind.FROZEN, 2, 2))
    for frame in frames[2:4]:
        for name in IMAGES:
            np.testing.assert_array_equal(getattr(frame, name), getattr(frames[1], name))
    assert np.any(frames[4].color_bgr != frames[1].color_bgr)
    assert len({frame.stamp_s for frame in frames}) == 6


def test_black_and_dark_do_not_change_the_depth(read_frames: ReadFrames) -> None:
    clean = read_frames()
    frames = read_frames(Fault(FaultKind.BLACK, 1), Fault(FaultKind.DARK, 2))
    assert not frames[1].color_bgr.any()
    assert 0 < frames[2].color_bgr.mean() < 8
    assert frames[2].color_bgr.std() > 1
    for seq in (1, 2):
        np.testing.assert_array_equal(frames[seq].depth_raw, clean[seq].depth_raw)


def test_a_covered_camera_sees_nothing(read_frames: ReadFrames) -> None:
    frames = read_frames(Fault(FaultKind.COVERED, 2, 2))
    covered = [not frame.color_bgr.any() and not frame.depth_raw.any() for frame in frames]
    assert covered == [False, False, True, True, False, False]


def test_noise_replaces_both_images_and_is_repeatable(read_frames: ReadFrames) -> None:
    clean, frames = read_frames(), read_frames(Fault(FaultKind.NOISE, 2))
    for name in IMAGES:
        was, noise = getattr(clean[2], name).ravel(), getattr(frames[2], name).ravel()
        assert abs(np.corrcoef(was, noise)[0, 1]) < 0.05
        np.testing.assert_array_equal(getattr(frames[3], name), getattr(clean[3], name))
    again = read_frames(Fault(FaultKind.NOISE, 2))
    np.testing.assert_array_equal(frames[2].color_bgr, again[2].color_bgr)


def test_a_torn_frame_is_new_above_and_old_below(read_frames: ReadFrames) -> None:
    clean, torn = read_frames(), read_frames(Fault(FaultKind.TORN, 3))[3]
    for name in IMAGES:
        image, half = getattr(torn, name), len(torn.depth_raw) // 2
        np.testing.assert_array_equal(image[:half], getattr(clean[3], name)[:half])
        np.testing.assert_array_equal(image[half:], getattr(clean[2], name)[half:])


def test_stamps_jump_and_repeat(read_frames: ReadFrames) -> None:
    clean = [frame.stamp_s for frame in read_frames()]
    jump = Fault(FaultKind.STAMP_JUMP, 2, 1, seconds=-0.5)
    stamps = [frame.stamp_s for frame in read_frames(jump, Fault(FaultKind.STAMP_REPEAT, 4, 2))]
    assert stamps[:2] == clean[:2]
    assert stamps[2] == pytest.approx(clean[2] - 0.5, abs=1e-6)
    assert stamps[3:] == [clean[3]] * 3
