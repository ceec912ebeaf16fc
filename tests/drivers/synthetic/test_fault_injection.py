from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import PlaybackMode
from drivers.core import CameraLostError, CameraNotFoundError
from drivers.synthetic.config import Fault, FaultKind, SyntheticConfig
from tests.drivers.fake_host import FakeHost
from tests.drivers.synthetic.cached_cameras import CachedCameras, read_frames


def test_a_dropped_frame_leaves_a_gap(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    with cached_cameras.open_camera(
        replace(ideal, faults=(Fault(FaultKind.DROPPED, 2, 2),))
    ) as camera:
        assert [frame.seq for frame in read_frames(camera)] == [0, 1, 4, 5]
        assert camera.counters.skipped == 2


def test_a_frozen_camera_repeats_its_last_images(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    frames = cached_cameras.read_frames(ideal, Fault(FaultKind.FROZEN, 2, 2))
    for frame in frames[2:4]:
        np.testing.assert_array_equal(frame.color_bgr, frames[1].color_bgr)
        np.testing.assert_array_equal(frame.depth_raw, frames[1].depth_raw)
    assert np.any(frames[4].color_bgr != frames[1].color_bgr)
    assert len({frame.stamp_s for frame in frames}) == 6


def test_black_and_dark_do_not_change_the_depth(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    clean, frames = (
        cached_cameras.read_frames(ideal),
        cached_cameras.read_frames(ideal, Fault(FaultKind.BLACK, 1), Fault(FaultKind.DARK, 2)),
    )
    assert not frames[1].color_bgr.any()
    assert 0 < frames[2].color_bgr.mean() < 8
    assert frames[2].color_bgr.std() > 1
    for seq in (1, 2):
        np.testing.assert_array_equal(frames[seq].depth_raw, clean[seq].depth_raw)


def test_a_covered_camera_sees_nothing(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    frames = cached_cameras.read_frames(ideal, Fault(FaultKind.COVERED, 2, 2))
    covered = [not frame.color_bgr.any() and not frame.depth_raw.any() for frame in frames]
    assert covered == [False, False, True, True, False, False]


def test_noise_replaces_both_images_and_is_repeatable(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    clean, frames = (
        cached_cameras.read_frames(ideal),
        cached_cameras.read_frames(ideal, Fault(FaultKind.NOISE, 2)),
    )
    for name in ("color_bgr", "depth_raw"):
        was, noise = getattr(clean[2], name).ravel(), getattr(frames[2], name).ravel()
        assert abs(np.corrcoef(was[: len(was) // 3], noise[: len(noise) // 3])[0, 1]) < 0.05
        np.testing.assert_array_equal(getattr(frames[3], name), getattr(clean[3], name))
    again = cached_cameras.read_frames(ideal, Fault(FaultKind.NOISE, 2))
    np.testing.assert_array_equal(frames[2].color_bgr, again[2].color_bgr)


def test_a_torn_frame_is_new_above_and_old_below(
    cached_cameras: CachedCameras, ideal: SyntheticConfig
) -> None:
    clean, torn = (
        cached_cameras.read_frames(ideal),
        cached_cameras.read_frames(ideal, Fault(FaultKind.TORN, 3))[3],
    )
    np.testing.assert_array_equal(torn.color_bgr[:48], clean[3].color_bgr[:48])
    np.testing.assert_array_equal(torn.color_bgr[48:], clean[2].color_bgr[48:])
    np.testing.assert_array_equal(torn.depth_raw[48:], clean[2].depth_raw[48:])


def test_stamps_jump_and_repeat(cached_cameras: CachedCameras, ideal: SyntheticConfig) -> None:
    jump = Fault(FaultKind.STAMP_JUMP, 2, 1, seconds=-0.5)
    stamps = [
        f.stamp_s
        for f in cached_cameras.read_frames(ideal, jump, Fault(FaultKind.STAMP_REPEAT, 4, 2))
    ]
    assert stamps == [1000.0, 1000.033333, 999.566667, 1000.1, 1000.1, 1000.1]


@pytest.mark.parametrize("pace", list(PlaybackMode))
def test_an_unplugged_camera_is_lost_then_not_found_then_back(
    cached_cameras: CachedCameras, ideal: SyntheticConfig, pace: PlaybackMode
) -> None:
    host = FakeHost()
    fault = Fault(FaultKind.UNPLUGGED, 2, seconds=0.09)
    camera = cached_cameras.open_camera(replace(ideal, faults=(fault,)), pace, host)
    camera.open()
    assert [camera.read(1.0).seq for _ in range(2)] == [0, 1]
    with pytest.raises(CameraLostError, match="unplugged"):
        camera.read(1.0)
    camera.close()
    with pytest.raises(CameraNotFoundError, match="comes back by itself"):
        camera.open()
    host.sleep(0.095)
    camera.open()
    assert [frame.seq for frame in read_frames(camera)] == [5]
    assert camera.counters.dropped == 0
