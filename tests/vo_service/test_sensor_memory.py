"""What a service has learned of a sensor is there at its next start."""

import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.calibration import KINECT_TIMING_PRIOR
from drivers.camera import FocalPrior, TimingPrior, TimingSource
from drivers.core import InputError
from tests.full_disk import limit_file_size
from tests.vo_service.fakes import FakeClock
from tests.vo_service.learned_updates import (
    FOCAL_LENGTH,
    LEARNED,
    SERIAL,
    learned_update,
    sensor_frame,
)
from tests.waiting import wait_until
from vo_service.sensor_memory import (
    SAVE_INTERVAL_S,
    RememberedSensor,
    SensorFiles,
    open_sensor_memory,
    read_remembered_sensor,
    sensor_file,
    write_remembered_sensor,
)
from vo_service.types.outputs import NullSensorMemory

OTHER = replace(LEARNED, serial="B2", readout_s=0.027)


@contextmanager
def memory(folder: Path, clock: FakeClock | None = None) -> Iterator[SensorFiles]:
    """The memory of one run that is stopped in order."""
    with closing(SensorFiles(folder, clock or FakeClock())) as files:
        yield files


def learn(folder: Path, *timings: RememberedSensor) -> None:
    """One run after another learns these."""
    for timing in timings:
        with memory(folder) as files:
            files.apply(sensor_frame(timing.serial))
            files.on_update(learned_update(timing))


def test_the_next_run_starts_with_what_was_learned(tmp_path: Path) -> None:
    learn(tmp_path, LEARNED)
    with memory(tmp_path) as files:
        frame = files.apply(sensor_frame())
    assert frame.readout_s == 0.0305
    assert frame.skew_s == pytest.approx(0.005 - 0.0027)
    assert frame.timing_prior == TimingPrior(-0.0027, 0.002, 0.001, TimingSource.MEMORY)


def test_a_larger_sigma_is_kept(tmp_path: Path) -> None:
    learn(tmp_path, replace(LEARNED, readout_sigma_s=0.0035))
    with memory(tmp_path) as files:
        prior = files.apply(sensor_frame()).timing_prior
    assert prior is not None
    assert prior.readout_sigma_s == 0.0035


@pytest.mark.parametrize(
    "told", [None, TimingPrior(0.001, 0.001, 0.0005, TimingSource.CAMERA_FILE)]
)
def test_what_the_camera_file_tells_wins(tmp_path: Path, told: TimingPrior | None) -> None:
    learn(tmp_path, LEARNED)
    frame = sensor_frame(prior=told)
    with memory(tmp_path) as files:
        assert files.apply(frame) is frame


WITH_FOCAL_LENGTH = replace(LEARNED, focal_length=FOCAL_LENGTH)


def test_the_next_run_starts_with_the_learned_focal_length_at_most_1_percent_certain(
    tmp_path: Path,
) -> None:
    learn(tmp_path, WITH_FOCAL_LENGTH)
    with memory(tmp_path) as files:
        assert files.apply(sensor_frame()).focal_prior == FocalPrior(1.035, 0.01)
    larger = replace(FOCAL_LENGTH, sigma=0.013)
    learn(tmp_path, replace(LEARNED, focal_length=larger))
    with memory(tmp_path) as files:
        assert files.apply(sensor_frame()).focal_prior == FocalPrior(1.035, 0.013)


def test_the_bias_of_the_accelerometer_is_remembered(tmp_path: Path) -> None:
    bias_m_s2 = (0.21, -0.13, 0.05)
    learn(tmp_path, replace(LEARNED, accelerometer_bias_m_s2=bias_m_s2), LEARNED)
    with memory(tmp_path) as files:
        assert files.apply(sensor_frame()).accelerometer_bias_m_s2 == bias_m_s2


def test_other_intrinsics_have_no_learned_focal_length(tmp_path: Path) -> None:
    learn(tmp_path, WITH_FOCAL_LENGTH)
    frame = sensor_frame()
    other = replace(frame, camera=replace(frame.camera, fx=frame.camera.fx + 1.0))
    with memory(tmp_path) as files:
        assert files.apply(other).focal_prior is None
        assert files.apply(frame).focal_prior is not None


def test_a_focal_length_is_remembered_until_another_is_certain(tmp_path: Path) -> None:
    learn(tmp_path, WITH_FOCAL_LENGTH, replace(LEARNED, readout_s=0.028))
    assert read_remembered_sensor(tmp_path, SERIAL) == replace(WITH_FOCAL_LENGTH, readout_s=0.028)
    unchanged = replace(FOCAL_LENGTH, scale=1.0)
    learn(tmp_path, replace(LEARNED, focal_length=unchanged))
    with memory(tmp_path) as files:
        assert files.apply(sensor_frame()).focal_prior is None


def test_a_focal_length_is_remembered_although_the_camera_file_tells_the_timing(
    tmp_path: Path,
) -> None:
    with memory(tmp_path) as files:
        files.apply(sensor_frame())
        files.on_update(learned_update(WITH_FOCAL_LENGTH, source="camera file"))
    assert read_remembered_sensor(tmp_path, SERIAL) == WITH_FOCAL_LENGTH


def test_a_sensor_without_a_serial_number_is_not_remembered(tmp_path: Path) -> None:
    learn(tmp_path / "timing", replace(LEARNED, serial=""))
    assert not (tmp_path / "timing").exists()


def test_another_sensor_has_its_own_timing(tmp_path: Path) -> None:
    learn(tmp_path, LEARNED, OTHER)
    with memory(tmp_path) as files:
        readouts_s = [files.apply(sensor_frame(serial)).readout_s for serial in (SERIAL, "B2")]
    assert readouts_s == [0.0305, 0.027]


def test_a_sensor_that_is_plugged_in_again_has_what_was_learned_before(tmp_path: Path) -> None:
    with memory(tmp_path) as files:
        files.apply(sensor_frame())
        files.on_update(learned_update())
        assert files.apply(sensor_frame("B2")).timing_prior == KINECT_TIMING_PRIOR
        assert files.apply(sensor_frame()).readout_s == LEARNED.readout_s
    assert not sensor_file(tmp_path, "B2").exists()


def test_an_estimate_that_is_not_certain_is_not_saved(tmp_path: Path) -> None:
    with memory(tmp_path) as files:
        files.apply(sensor_frame())
        files.on_update(learned_update(source="usual for the sensor"))
    assert read_remembered_sensor(tmp_path, SERIAL) is None


def test_during_a_run_it_is_saved_once_a_minute_if_it_has_changed(tmp_path: Path) -> None:
    clock = FakeClock()

    def saved() -> RememberedSensor | None:
        return read_remembered_sensor(tmp_path, SERIAL)

    with memory(tmp_path, clock) as files:
        files.apply(sensor_frame())
        files.on_update(learned_update())
        wait_until(lambda: saved() == LEARNED)
        moved = replace(LEARNED, readout_s=LEARNED.readout_s + 0.002)
        files.on_update(learned_update(moved))
        clock.now_s += SAVE_INTERVAL_S
        files.on_update(learned_update(replace(LEARNED, readout_s=LEARNED.readout_s + 0.001)))
        files.on_update(learned_update(moved))
        wait_until(lambda: saved() == moved)


def test_less_than_a_sigma_is_saved_at_the_end(tmp_path: Path) -> None:
    last = replace(LEARNED, readout_s=0.0306, readout_sigma_s=0.0008)
    with memory(tmp_path) as files:
        files.apply(sensor_frame())
        files.on_update(learned_update())
        files.on_update(learned_update(last))
    assert read_remembered_sensor(tmp_path, SERIAL) == last


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "`schema`: is missing"),
        (b"\x00\xff\x00", "is not UTF-8"),
        (b"schema = 1\nserial = 3\n", "wrong type"),
        (b"schema = 1\n[nonsense", "not TOML"),
    ],
)
def test_a_damaged_file_is_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, content: bytes, reason: str
) -> None:
    path = sensor_file(tmp_path, SERIAL)
    path.write_bytes(content)
    with memory(tmp_path) as files:
        frames = [files.apply(sensor_frame()) for _ in range(3)]
        assert str(path) in files.warning
        files.on_update(learned_update())
        wait_until(lambda: not files.warning)
    assert {frame.timing_prior for frame in frames} == {KINECT_TIMING_PRIOR}
    (record,) = caplog.records
    assert reason in record.message
    assert "the usual values hold" in record.message
    assert read_remembered_sensor(tmp_path, SERIAL) == LEARNED


def test_the_file_of_another_sensor_is_refused(tmp_path: Path) -> None:
    write_remembered_sensor(tmp_path, OTHER)
    sensor_file(tmp_path, "B2").rename(sensor_file(tmp_path, SERIAL))
    with pytest.raises(InputError, match="is the file of the sensor 'B2'"):
        read_remembered_sensor(tmp_path, SERIAL)


@pytest.mark.parametrize("serial", ["../x", "a/b", 'quote"\\', "ß 東\n"])
def test_any_serial_number_has_a_file(tmp_path: Path, serial: str) -> None:
    timing = replace(LEARNED, serial=serial)
    write_remembered_sensor(tmp_path / "timing", timing)
    assert read_remembered_sensor(tmp_path / "timing", serial) == timing
    assert [path.parent.name for path in tmp_path.rglob("*.toml")] == ["timing"]


def test_a_full_disk_is_one_warning_and_the_file_before_stays(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    learn(tmp_path, LEARNED)
    with limit_file_size(8):
        learn(tmp_path, replace(LEARNED, readout_s=0.027))
    with limit_file_size(8), memory(tmp_path) as files:
        for serial in (SERIAL, "B2", SERIAL, "C3"):
            files.apply(sensor_frame(serial))
            files.on_update(learned_update(replace(OTHER, serial=serial)))
        wait_until(lambda: "the disk is full" in files.warning)
    assert [record.levelno for record in caplog.records] == [logging.WARNING] * 2
    assert read_remembered_sensor(tmp_path, SERIAL) == LEARNED
    assert {path.name for path in tmp_path.iterdir()} == {f"{SERIAL}.toml"}


def test_without_a_state_folder_it_is_switched_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME", "HOME"):
        monkeypatch.setenv(name, str(tmp_path / "file"))
    assert "XDG_STATE_HOME" in open_sensor_memory("learned").warning


def test_a_fixed_timing_uses_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    with closing(open_sensor_memory("fixed")) as fixed:
        assert isinstance(fixed, NullSensorMemory)
        frame = sensor_frame()
        assert fixed.apply(frame) is frame
        fixed.on_update(learned_update())
    assert not list(tmp_path.iterdir())
