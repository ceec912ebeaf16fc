from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import Clock, FrameTimeout, PlaybackMode
from drivers.core import CameraLostError, CameraNotFoundError, InputError
from drivers.faulty_camera import Fault, FaultKind
from drivers.synthetic.config import ColorSensorModel, ShutterTiming, SyntheticConfig
from tests.drivers.fake_host import FakeHost
from tests.drivers.synthetic.cached_cameras import CachedCameras, read_frames
from tests.drivers.synthetic.conftest import FAULTY, IDEAL

pytestmark = pytest.mark.slow


def test_lockstep_delivers_every_frame_under_fixed_stamps(cached_cameras: CachedCameras) -> None:
    with cached_cameras.open_camera(FAULTY) as camera:
        frames = read_frames(camera)
        assert camera.clock is Clock.RECORDED
        assert camera.frame_count == len(frames) == 6
        assert camera.counters.delivered == 6
    assert [frame.seq for frame in frames] == list(range(6))
    assert [frame.stamp_s for frame in frames[:3]] == [1000.0, 1000.033333, 1000.066667]
    assert frames[0].skew_s == FAULTY.timing.skew_s
    assert frames[0].readout_s == FAULTY.timing.readout_s > 0
    assert frames[0].depth_factor == FAULTY.depth_factor


def test_ground_truth_is_stamped_like_the_frames(cached_cameras: CachedCameras) -> None:
    camera = cached_cameras.open_camera(IDEAL)
    with camera:
        stamps = [frame.stamp_s for frame in read_frames(camera)]
    truth = camera.ground_truth
    assert truth is not None
    assert truth.stamps_s.tolist() == stamps
    assert truth.T_world_camera.shape == (6, 4, 4)


def test_opening_again_starts_over_and_counts_on(cached_cameras: CachedCameras) -> None:
    camera = cached_cameras.open_camera(IDEAL)
    with camera:
        first = camera.read(1.0)
        camera.read(1.0)
    camera.close()
    with camera:
        again = camera.read(1.0)
        assert camera.counters.delivered == 3
    assert (again.seq, again.stamp_s) == (first.seq, first.stamp_s)
    with pytest.raises(CameraLostError, match="not open"):
        camera.read(1.0)


def test_a_loop_has_no_seam(cached_cameras: CachedCameras) -> None:
    with cached_cameras.open_camera(replace(IDEAL, loop=True)) as camera:
        frames = [camera.read(1.0) for _ in range(14)]
        assert camera.frame_count is None
        assert camera.ground_truth is None
    np.testing.assert_array_equal(frames[0].color_bgr, frames[6].color_bgr)
    assert [frame.seq for frame in frames] == list(range(14))
    assert np.all(np.diff([frame.stamp_s for frame in frames]) > 0.033)


def test_live_frames_come_when_due_and_stamped_by_the_host(cached_cameras: CachedCameras) -> None:
    host = FakeHost()
    with cached_cameras.open_camera(FAULTY, PlaybackMode.REALTIME, host) as camera:
        assert camera.clock is Clock.MONOTONIC
        with pytest.raises(FrameTimeout):
            camera.read(0.005)
        frames = read_frames(camera)
    assert [frame.seq for frame in frames] == list(range(6))
    assert frames[3].stamp_s == 5000.1
    # The last row and the depth come after the middle of the color image.
    assert frames[3].receive_time_s == pytest.approx(5000.1 + 0.010 + 0.010)
    assert host.now_s == pytest.approx(frames[5].receive_time_s)


def test_a_slow_reader_gets_the_newest_frame_and_the_rest_is_counted(
    cached_cameras: CachedCameras,
) -> None:
    host = FakeHost()
    with cached_cameras.open_camera(FAULTY, PlaybackMode.REALTIME, host) as camera:
        seqs = [camera.read(1.0).seq]
        host.sleep(0.11)
        seqs += [camera.read(1.0).seq, camera.read(1.0).seq]
        assert seqs == [0, 3, 4]
        assert camera.counters.dropped == 2
        host.sleep(9.0)
        assert camera.read(1.0).seq == 5
        assert camera.counters.dropped == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"duration_s": 0.0}, "duration_s"),
        ({"depth_factor": 0.0}, "depth_factor"),
        ({"timing": ShutterTiming(skew_s=0.02)}, "timing.skew_s exceeds half a frame"),
        ({"timing": ShutterTiming(readout_s=0.05)}, "readout_s"),
        ({"color": ColorSensorModel(distortion=(0.1,))}, "k1 k2 p1 p2 k3"),
    ],
)
def test_invalid_values_are_rejected_by_name(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(SyntheticConfig(), **change)  # type: ignore[arg-type]


def test_every_frame_has_about_the_direction_of_gravity(cached_cameras: CachedCameras) -> None:
    with cached_cameras.open_camera(IDEAL) as camera:
        frames = read_frames(camera)
        truth = camera.ground_truth
    assert truth is not None
    for frame, T_world_camera in zip(frames, truth.T_world_camera, strict=True):
        assert frame.gravity_m_s2 is not None
        found = T_world_camera[:3, :3] @ frame.gravity_m_s2
        np.testing.assert_allclose(found, [0.0, 0.0, -9.80665], atol=0.5)


@pytest.mark.parametrize("pace", list(PlaybackMode))
def test_an_unplugged_camera_is_lost_then_not_found_then_back(
    cached_cameras: CachedCameras, pace: PlaybackMode
) -> None:
    host = FakeHost()
    fault = Fault(FaultKind.UNPLUGGED, 2, seconds=0.09)
    camera = cached_cameras.open_camera(replace(IDEAL, faults=(fault,)), pace, host)
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
