from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.calibration import (
    KINECT_TIMING_PRIOR,
    CameraCalibration,
    format_calibration,
)
from drivers.camera import CameraState, RgbdFrame, SensorConfig
from drivers.core import CameraLostError, CameraNotFoundError, InputError
from drivers.rectify import Undistorter
from tests.drivers.freenect.conftest import KINECT_CALIBRATION, MakeCamera, plug_in
from tests.simulators.fixtures import FRAME_COUNT, SimulateKinect, pattern_frame
from tests.simulators.kinect_registration import quantize_mm
from tests.simulators.kinect_simulator import KinectModel, KinectSimulator
from tests.waiting import wait_until

# Where the color sensor's firmware keeps its automatic functions.
SWITCHES = 0x106


def write_file(folder: Path, calibration: CameraCalibration) -> Path:
    file = folder / "camera.toml"
    file.write_text(format_calibration(calibration))
    return file


def pattern_seq(frame: RgbdFrame) -> int:
    """Which frame of the sequence this is, told by its depth at one near pixel."""
    told = [quantize_mm(pattern_frame(seq)[1])[20, 20] for seq in range(FRAME_COUNT)]
    return told.index(frame.depth_raw[20, 20])


def cmos(kinect: KinectSimulator) -> Any:
    """The registers of the color sensor."""
    return kinect._control.cmos


@pytest.mark.parametrize("model", list(KinectModel))
def test_each_model_delivers_exactly_the_transmitted_pixels(
    model: KinectModel, simulate_kinect: SimulateKinect, make_camera: MakeCamera
) -> None:
    kinect = plug_in(simulate_kinect, model=model)
    with make_camera(kinect.serial) as camera:
        frames = [camera.read(3.0) for _ in range(3)]
    for frame in frames:
        bgr, depth_mm = pattern_frame(pattern_seq(frame))
        assert np.array_equal(frame.depth_raw, quantize_mm(depth_mm))
        # The mosaic leaves out two of three colors; where brightness wraps, it shows edges.
        off = np.abs(frame.color_bgr.astype(int) - bgr)[2:-2, 2:-2]
        assert np.median(off) <= 1
        assert np.mean(off <= 4) > 0.9
    assert kinect.abandoned_transfers == 0


def test_counters_continue_when_the_camera_is_opened_again(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    camera = make_camera(kinect.serial)
    for opened in (1, 2):
        with camera:
            for _ in range(2):
                camera.read(3.0)
            assert camera.counters.delivered == 2 * opened
        assert camera.counters.delivered == 2 * opened


def test_frames_are_numbered_stamped_and_described(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    kinect.color_offset_s = 0.006
    with make_camera() as camera:
        frames = [camera.read(3.0) for _ in range(10)]
        assert camera.status.state is CameraState.STREAMING
        assert camera.intrinsics_source == "default"
        missing = frames[-1].seq + 1 - len(frames)
        # One more may have come since.
        assert camera.counters.skipped <= missing + 1
    for before, after in pairwise(frames):
        steps = after.seq - before.seq
        assert steps >= 1
        assert before.device_stamp_s is not None
        assert after.device_stamp_s == pytest.approx(before.device_stamp_s + steps / 30, abs=1e-6)
    for frame in frames:
        assert frame.skew_s == pytest.approx(-0.006, abs=1e-6)
        assert frame.stamp_s < frame.receive_time_s
        assert (frame.depth_factor, frame.camera.fx, frame.lost_packets) == (1000.0, 525.0, 0)


def test_stamps_increase_across_the_wrap_of_the_device_clock(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    kinect.start_ticks = 2**32 - 60_000_000 // 4
    kinect.color_offset_s = -0.001
    with make_camera() as camera:
        frames = [camera.read(3.0) for _ in range(15)]
    device_s = np.array([frame.device_stamp_s for frame in frames])
    seqs = np.array([frame.seq for frame in frames])
    assert device_s[0] < 2**32 / 60e6 < device_s[-1]
    np.testing.assert_allclose(device_s - device_s[0], (seqs - seqs[0]) / 30, atol=1e-6)
    assert all(a.stamp_s < b.stamp_s for a, b in pairwise(frames))
    assert {round(frame.skew_s, 6) for frame in frames} == {0.001}


def test_settings_are_applied_at_each_opening(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    camera = make_camera(settings=SensorConfig(auto_exposure=False, auto_white_balance=False))
    for _ in range(2):
        kinect.unplug()
        kinect.plug()
        cmos(kinect)[SWITCHES] = 0x7FFF
        with camera:
            assert cmos(kinect)[SWITCHES] == 0x7FFF & ~(1 << 14) & ~(1 << 1)
    with make_camera():
        assert cmos(kinect)[SWITCHES] == 0x7FFF


def test_a_mirrored_camera_swaps_left_and_right_after_registration(
    kinect: KinectSimulator, make_camera: MakeCamera, tmp_path: Path
) -> None:
    file = write_file(tmp_path, replace(KINECT_CALIBRATION, cx=300.0))
    with make_camera(settings=SensorConfig(mirror=True), camera_file=file) as camera:
        frame = camera.read(3.0)
    mirrored = np.ascontiguousarray(frame.depth_raw[:, ::-1])
    seq = pattern_seq(replace(frame, depth_raw=mirrored))
    assert np.array_equal(mirrored, quantize_mm(pattern_frame(seq)[1]))
    assert frame.camera.cx == 639 - 300.0


def test_the_camera_file_gives_distortion_intrinsics_and_depth_scale(
    kinect: KinectSimulator, make_camera: MakeCamera, tmp_path: Path
) -> None:
    bent = replace(
        KINECT_CALIBRATION, fx=520.0, distortion=(0.1, -0.05, 0.0, 0.0, 0.0), depth_factor=1010.0
    )
    with make_camera(camera_file=write_file(tmp_path, bent)) as camera:
        frame = camera.read(3.0)
    lens = Undistorter(bent.pinhole, bent.distortion)
    expected = [
        lens.undistort_depth(quantize_mm(pattern_frame(seq)[1])) for seq in range(FRAME_COUNT)
    ]
    assert any(np.array_equal(frame.depth_raw, depth) for depth in expected)
    assert (frame.camera.fx, frame.depth_factor) == (520.0, 1010.0)


def test_a_file_for_other_images_is_rejected_at_once(
    make_camera: MakeCamera, tmp_path: Path
) -> None:
    other = replace(KINECT_CALIBRATION, width=600, height=450)
    with pytest.raises(InputError, match=r"camera.toml is for 600x450; give the camera file"):
        make_camera(camera_file=write_file(tmp_path, other))


def test_the_camera_file_gives_the_timing(
    kinect: KinectSimulator, make_camera: MakeCamera, tmp_path: Path
) -> None:
    with make_camera() as camera:
        unknown = camera.read(3.0)
    file = write_file(tmp_path, replace(KINECT_CALIBRATION, readout_s=0.019, depth_offset_s=0.004))
    with make_camera(camera_file=file) as camera:
        frame = camera.read(3.0)
    assert (unknown.readout_s, frame.readout_s) == (0.029, 0.019)
    assert frame.skew_s - unknown.skew_s == pytest.approx(0.004, abs=2e-6)
    assert unknown.timing_prior == KINECT_TIMING_PRIOR
    assert camera.intrinsics_source == f"camera file {file}"


def test_the_newest_frame_is_read_and_dropped_ones_are_counted(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera() as camera:
        first = camera.read(3.0)
        wait_until(lambda: camera.counters.dropped >= 3)
        second = camera.read(3.0)
        assert second.seq - first.seq > 3
        assert camera.counters.delivered == 2


def test_the_kinect_with_the_requested_serial_is_opened(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera(kinect.serial) as camera:
        assert camera.read(3.0).serial == kinect.serial
    with pytest.raises(
        CameraNotFoundError, match=f"B999 is on the USB; connected: {kinect.serial}"
    ):
        make_camera("B999").open()


def test_closing_stops_both_streams_at_any_time(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    camera = make_camera()
    camera.close()
    with camera:
        camera.read(3.0)
        assert kinect.streaming == (True, True)
    camera.close()
    assert (kinect.streaming, kinect.open_handles) == ((False, False), 0)
    with pytest.raises(CameraLostError, match="not open"):
        camera.read(0.0)
