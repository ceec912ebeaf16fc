"""Recordings played by the real libOpenNI2."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.calibration import format_calibration, read_calibration
from drivers.camera import EndOfStream, PlaybackMode, RgbdFrame, SensorConfig
from drivers.core import CameraError, InputError
from drivers.openni2.oni_camera import OniCamera
from drivers.playback.camera import RecordingCamera
from tests.drivers.fake_host import FakeHost
from tests.drivers.openni2.conftest import SIZE, make_image, make_images, read_all_frames
from tests.resource_leaks import resources_in_use
from tests.simulators.oni_writer import DEPTH_100_UM, OniImage, OniSensor, OniSettings, write_oni


def written(path: Path, images: Sequence[OniImage], settings: OniSettings | None = None) -> Path:
    write_oni(path, images, settings)
    return path


def whole(frame: RgbdFrame) -> tuple[object, ...]:
    """Everything but the images and the time of day."""
    return (frame.seq, frame.stamp_s, frame.skew_s, frame.camera, frame.depth_factor)


def test_frames_are_those_of_the_folder_bit_for_bit(corner_oni: Path, in_millimeters: Path) -> None:
    played = list(read_all_frames(OniCamera(corner_oni, in_millimeters / "camera.toml")))
    recorded = list(read_all_frames(RecordingCamera(in_millimeters)))
    assert len(played) == len(recorded) == 12
    for ours, theirs in zip(played, recorded, strict=True):
        np.testing.assert_array_equal(ours.color_bgr, theirs.color_bgr)
        np.testing.assert_array_equal(ours.depth_raw, theirs.depth_raw)
        assert whole(ours) == whole(theirs)


# Which sensor the next image in the file is of, and how far its stamp is after the one before.
turns = st.lists(st.tuples(st.sampled_from(OniSensor), st.integers(1_000, 40_000)), max_size=24)


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(turns=turns)
def test_every_image_is_played_in_any_order_of_the_file(
    turns: list[tuple[OniSensor, int]], tmp_path: Path, camera_file: Path
) -> None:
    stamps_us = dict.fromkeys(OniSensor, 0)
    images = [make_image(sensor, 0) for sensor in OniSensor]
    for sensor, step_us in turns:
        stamps_us[sensor] += step_us
        images.append(make_image(sensor, stamps_us[sensor]))
    by_stamp = {(i.sensor, i.stamp_us): i.pixels for i in images}
    camera = OniCamera(written(tmp_path / "any.oni", images), camera_file)
    frames = list(read_all_frames(camera))
    assert camera.counters.delivered == len(frames) == camera.frame_count
    for frame in frames:
        color_us = round(frame.stamp_s * 1e6)
        depth_us = color_us + round(frame.skew_s * 1e6)
        np.testing.assert_array_equal(frame.color_bgr, by_stamp[OniSensor.COLOR, color_us])
        np.testing.assert_array_equal(frame.depth_raw, by_stamp[OniSensor.DEPTH, depth_us])


def test_the_camera_file_gives_the_timing(
    small_oni: Path, camera_file: Path, tmp_path: Path
) -> None:
    known, file = read_calibration(camera_file), tmp_path / "timed.toml"
    file.write_text(format_calibration(replace(known, readout_s=0.019, depth_offset_s=0.004)))
    frames = list(read_all_frames(OniCamera(small_oni, file)))
    assert {frame.readout_s for frame in frames} == {0.019}
    assert [frame.skew_s for frame in frames] == pytest.approx([0.006] * 8)


def test_images_without_a_partner_are_left_out(tmp_path: Path, camera_file: Path) -> None:
    path = written(tmp_path / "odd.oni", [*make_images(3), make_image(OniSensor.DEPTH, 500_000)])
    camera = OniCamera(path, camera_file)
    assert camera.frame_count is None
    assert len(list(read_all_frames(camera))) == camera.frame_count == 3


def test_realtime_drops_and_counts_late_frames(tmp_path: Path, camera_file: Path) -> None:
    path, host = written(tmp_path / "long.oni", make_images(30)), FakeHost()
    with OniCamera(path, camera_file, PlaybackMode.REALTIME, host=host.clock) as camera:
        first = camera.read(5.0)
        host.sleep(0.3)
        second = camera.read(5.0)
        counters = camera.counters
    assert first.seq == 0
    assert second.seq > 1
    assert counters.dropped == second.seq - 1
    assert counters.delivered == 2


def test_realtime_gives_the_same_frames_to_a_fast_reader(
    small_oni: Path, camera_file: Path
) -> None:
    lockstep = {frame.seq: frame for frame in read_all_frames(OniCamera(small_oni, camera_file))}
    camera = OniCamera(small_oni, camera_file, PlaybackMode.REALTIME)
    for frame in read_all_frames(camera):
        np.testing.assert_array_equal(frame.depth_raw, lockstep[frame.seq].depth_raw)
    assert camera.counters.delivered + camera.counters.dropped == 8


def test_depth_in_tenths_of_a_millimeter_has_its_own_factor(
    tmp_path: Path, camera_file: Path
) -> None:
    path = written(tmp_path / "fine.oni", make_images(2), OniSettings(depth_format=DEPTH_100_UM))
    fine = tmp_path / "camera.toml"
    fine.write_text(camera_file.read_text().replace("1000.0", "10000.0"))
    assert next(read_all_frames(OniCamera(path, fine))).depth_factor == 10000.0
    with pytest.raises(InputError, match=r"depth_factor is 1000, .* set depth_factor = 10000.0"):
        OniCamera(path, camera_file).open()


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("wanted", [True, False])
def test_mirroring_follows_the_settings(
    recorded: bool, wanted: bool, tmp_path: Path, camera_file: Path
) -> None:
    images = make_images(1)
    path = written(tmp_path / "mirror.oni", images, OniSettings(mirror=recorded))
    camera = OniCamera(path, camera_file, settings=SensorConfig(mirror=wanted))
    frame = next(read_all_frames(camera))
    step = 1 if recorded == wanted else -1
    np.testing.assert_array_equal(frame.depth_raw, images[0].pixels[:, ::step])
    np.testing.assert_array_equal(frame.color_bgr, images[1].pixels[:, ::step])


def test_closes_in_the_middle_and_restarts(small_oni: Path, camera_file: Path) -> None:
    camera = OniCamera(small_oni, camera_file)
    for _ in range(2):
        camera.open()
        assert [camera.read(5.0).seq for _ in range(2)] == [0, 1]
        camera.close()
    assert camera.counters.delivered == 4
    with pytest.raises(CameraError, match="not open"):
        camera.read(0.1)


def test_end_of_stream_is_repeated(small_oni: Path, camera_file: Path) -> None:
    with OniCamera(small_oni, camera_file) as camera:
        for _ in range(8):
            camera.read(5.0)
        for _ in range(2):
            with pytest.raises(EndOfStream):
                camera.read(5.0)


def test_opening_and_closing_leaks_nothing(small_oni: Path, camera_file: Path) -> None:
    camera = OniCamera(small_oni, camera_file)

    def held() -> Counter[str]:
        with camera:
            camera.read(5.0)
        return resources_in_use()

    before = held()
    assert all(held() <= before for _ in range(3))


def test_source_of_the_intrinsics_is_reported(small_oni: Path, camera_file: Path) -> None:
    with OniCamera(small_oni, camera_file) as camera:
        assert camera.intrinsics_source == f"camera file {camera_file}"
        assert (camera.read(5.0).camera.width, camera.read(5.0).camera.height) == SIZE
