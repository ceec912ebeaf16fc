"""The live camera on the real libOpenNI2, whose file driver stands in for a sensor.

A recording opened as a device runs on its own clock, drops what is not fetched in time, registers
nothing and synchronizes nothing, as a plain sensor would.
"""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import format_calibration, read_calibration
from drivers.camera import CameraState, Clock, FrameTimeout, SensorConfig
from drivers.core import (
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    InputError,
    UserFacingError,
)
from drivers.openni2 import bindings
from drivers.openni2.camera import OpenNI2Camera
from drivers.openni2.device import list_devices
from tests.drivers.openni2.conftest import CAMERA_FILE, DEPTH_CAMERA, make_image, make_images
from tests.simulators.oni_writer import OniImage, OniSensor, OniSettings, write_oni

DUMMY = """
import sys
from pathlib import Path
from drivers.openni2.camera import OpenNI2Camera

for _ in range(2):
    with OpenNI2Camera("Dummy", Path(sys.argv[1])) as camera:
        frames = [camera.read(2.0) for _ in range(5)]
    stamps_s = [frame.stamp_s for frame in frames]
    assert stamps_s == sorted(set(stamps_s)), stamps_s
    assert {frame.depth_raw.shape for frame in frames} == {(240, 320)}
    assert len(list(Path("/proc/self/fd").iterdir())) < 20
print("well")
"""


def sensor(path: Path, images: list[OniImage], settings: OniSettings | None = None) -> str:
    """The URI of a sensor that delivers `images`."""
    write_oni(path, images, settings)
    return str(path)


def read_on(camera: OpenNI2Camera) -> None:
    """Read until something happens."""
    while True:
        camera.read(5.0)


def test_frames_are_those_of_the_sensor(tmp_path: Path, depth_camera_file: Path) -> None:
    images = make_images(60)
    by_stamp = {(sent.sensor, sent.stamp_us): sent.pixels for sent in images}
    with OpenNI2Camera(sensor(tmp_path / "a.oni", images), depth_camera_file) as camera:
        frames = [camera.read(2.0) for _ in range(10)]
    for frame in frames:
        assert frame.device_stamp_s is not None
        stamp_us = round(frame.device_stamp_s * 1e6)
        np.testing.assert_array_equal(frame.color_bgr, by_stamp[OniSensor.COLOR, stamp_us])
        np.testing.assert_array_equal(frame.depth_raw, by_stamp[OniSensor.DEPTH, stamp_us + 2_000])
        assert frame.skew_s == pytest.approx(0.002)
        assert frame.depth_factor == 1000.0


def test_the_camera_file_gives_the_timing(tmp_path: Path, depth_camera_file: Path) -> None:
    file = tmp_path / "timed.toml"
    known = read_calibration(depth_camera_file)
    file.write_text(format_calibration(replace(known, readout_s=0.019, depth_offset_s=0.004)))
    with OpenNI2Camera(sensor(tmp_path / "a.oni", make_images(60)), file) as camera:
        frame = camera.read(2.0)
    assert frame.readout_s == 0.019
    assert frame.skew_s == pytest.approx(0.006)


def test_stamps_increase_on_the_host_clock(tmp_path: Path, depth_camera_file: Path) -> None:
    before_s = time.monotonic()
    with OpenNI2Camera(sensor(tmp_path / "a.oni", make_images(60)), depth_camera_file) as camera:
        frames = [camera.read(2.0) for _ in range(10)]
    after_s = time.monotonic()
    stamps_s = np.array([frame.stamp_s for frame in frames])
    assert camera.clock is Clock.MONOTONIC
    assert np.all(np.diff(stamps_s) > 0)
    assert before_s - 0.1 < stamps_s[0] < stamps_s[-1] < after_s
    assert all(frame.stamp_s < frame.receive_time_s for frame in frames)


def test_slow_reader_gets_the_newest_frame_and_dropped_ones_are_counted(
    tmp_path: Path, depth_camera_file: Path
) -> None:
    with OpenNI2Camera(sensor(tmp_path / "a.oni", make_images(60)), depth_camera_file) as camera:
        first = camera.read(2.0)
        time.sleep(0.3)  # frames pass in the library, which tells nobody
        second = camera.read(2.0)
        counters = camera.counters
    assert second.seq > first.seq + 3
    assert counters.dropped == second.seq - 1
    assert counters.delivered == 2


def test_stream_that_stops_is_a_lost_camera(tmp_path: Path, depth_camera_file: Path) -> None:
    depth_goes_on = [make_image(OniSensor.DEPTH, seq * 33_333) for seq in range(4, 90)]
    uri = sensor(tmp_path / "a.oni", make_images(4) + depth_goes_on)
    with OpenNI2Camera(uri, depth_camera_file) as camera:
        with pytest.raises(CameraLostError, match="its color stream stopped for 1 s"):
            read_on(camera)
        assert camera.status.state is CameraState.LOST
        assert "color stream stopped" in camera.status.reason


def test_stream_that_never_starts_is_a_lost_camera(tmp_path: Path, depth_camera_file: Path) -> None:
    late = [make_image(OniSensor.COLOR, seq * 33_333) for seq in range(120)]
    uri = sensor(tmp_path / "a.oni", [*late, make_image(OniSensor.DEPTH, 120 * 33_333)])
    with (
        OpenNI2Camera(uri, depth_camera_file) as camera,
        pytest.raises(CameraLostError, match="its depth stream did not start"),
    ):
        camera.read(10.0)


def test_no_frame_within_the_timeout_is_a_frame_timeout(
    tmp_path: Path, depth_camera_file: Path
) -> None:
    apart = [make_image(OniSensor.DEPTH, 0), make_image(OniSensor.COLOR, 900_000)]
    with (
        OpenNI2Camera(sensor(tmp_path / "a.oni", apart), depth_camera_file) as camera,
        pytest.raises(FrameTimeout),
    ):
        camera.read(0.1)


def test_status_follows_the_camera(tmp_path: Path, depth_camera_file: Path) -> None:
    camera = OpenNI2Camera(sensor(tmp_path / "a.oni", make_images(30)), depth_camera_file)
    seen = [camera.status.state]
    with camera:
        seen.append(camera.status.state)
        camera.read(2.0)
        seen.append(camera.status.state)
    assert seen == [CameraState.ABSENT, CameraState.STARTING, CameraState.STREAMING]
    with pytest.raises(CameraError, match="is not open"):
        camera.read(0.1)


def test_image_is_mirrored_in_software_if_the_sensor_cannot(
    tmp_path: Path, depth_camera_file: Path
) -> None:
    depth, color = make_images(1)
    later_us = [seq * 33_333 for seq in range(30)]
    images = [replace(view, stamp_us=us) for us in later_us for view in (depth, color)]
    uri = sensor(tmp_path / "a.oni", images)
    with OpenNI2Camera(uri, depth_camera_file, SensorConfig(mirror=True)) as camera:
        frame = camera.read(2.0)
    np.testing.assert_array_equal(frame.depth_raw, depth.pixels[:, ::-1])
    np.testing.assert_array_equal(frame.color_bgr, color.pixels[:, ::-1])


def test_unregistered_depth_is_rejected(tmp_path: Path) -> None:
    camera = OpenNI2Camera(sensor(tmp_path / "a.oni", make_images(5)))
    with pytest.raises(InputError, match=r"does not register .* give a camera file with a \[depth"):
        camera.open()


def test_missing_sensor(depth_camera_file: Path) -> None:
    camera = OpenNI2Camera("1d27/0601@1/99", depth_camera_file)
    with pytest.raises(CameraNotFoundError, match="no sensor has this URI or serial number"):
        camera.open()
    assert camera.status.state is CameraState.ABSENT


def test_playing_recording_is_not_listed_as_a_device(
    tmp_path: Path, depth_camera_file: Path
) -> None:
    uri = sensor(tmp_path / "a.oni", make_images(30))
    with OpenNI2Camera(uri, depth_camera_file) as camera:
        camera.read(2.0)
        assert uri not in {device.uri for device in list_devices()}


def test_missing_library_is_one_line_with_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bindings, "SONAME", "libNotHere.so.0")
    with pytest.raises(UserFacingError, match="apt install libopenni2-0"):
        OpenNI2Camera().open()


@pytest.mark.subprocess
def test_dummy_device_opens_and_closes_without_a_crash(tmp_path: Path) -> None:
    text = CAMERA_FILE + DEPTH_CAMERA
    for small, large in (("64", "320"), ("48", "240"), ("52.5", "262.5"), ("31.5", "159.5")):
        text = text.replace(small, large)
    text = text.replace("23.5", "119.5")
    camera_file = tmp_path / "camera.toml"
    camera_file.write_text(text)
    run = subprocess.run(
        [sys.executable, "-c", DUMMY, str(camera_file)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (run.returncode, run.stdout.strip()) == (0, "well"), run.stderr
