"""The scan, the map, the wheels and the accelerometer of a recorded run, in other formats."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from drivers.camera import AccelerometerReading, PlaybackMode
from drivers.recording.odometry import OdometryRecord
from tests.vo_service.navigation.views import mounted, update_of, wall_on_floor
from tests.vo_service.tools.test_convert import OUTPUTS, convert_path, encoded_messages
from tests.vo_service.wheel_odometry.wheel_driver import CURVE, pose_at, wheel_message
from vo_service.config_tables import ScanConfig
from vo_service.navigation.frame_scans import FrameScans
from vo_service.outputs.mcap_recording import open_mcap_recording
from vo_service.tools.convert import OutputFormat
from vo_service.types.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

MOUNT = mounted(0.5, 10.0)
TOPICS = ("/scan", "/map", "/wheel_odom", "/imu")
START_S = 1305031453.25


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """An MCAP file of a run: three frames, each with a scan and a new map."""
    scans = FrameScans(ScanConfig(), MOUNT)
    scans.load()
    wheels = [
        OdometryRecord(stamp_s, wheel_message(stamp_s, pose_at(0.0), CURVE))
        for stamp_s in (START_S, START_S + 0.05)
    ]
    output = open_mcap_recording(
        tmp_path / "a.mcap",
        PlaybackMode.LOCKSTEP,
        wheel_messages=lambda: [wheels.pop(0)] if wheels else [],
        T_base_camera=MOUNT,
    )
    for number in range(3):
        stamp_s = START_S + 0.1 * number
        frame = wall_on_floor(MOUNT, 2.0 + 0.5 * number)
        frame = replace(frame, accelerometer=(AccelerometerReading(stamp_s, (0.0, -9.7, 1.7)),))
        cells = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE]][: 1 + number // 2], np.int8)
        grid = OccupancyGrid(cells, 0.05, (1.0, -2.0))
        update = replace(update_of(frame, MOUNT, stamp_s), seq=number, grid=grid)
        output.on_update(scans.add_to(update))
    output.close()
    return tmp_path / "a.mcap"


def read_all(path: Path, topic: str) -> list[Any]:
    with AnyReader([path]) as reader:
        connections = [each for each in reader.connections if each.topic == topic]
        return [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages(connections)
        ]


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_scan_map_wheels_and_accelerometer_are_the_same_after_there_and_back(
    recorded: Path, tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    convert_path(recorded, tmp_path / "there" / name, kind)
    convert_path(tmp_path / "there" / name, tmp_path / "back.mcap")
    before, after = (
        [message for message in encoded_messages(path) if message[0] in TOPICS]
        for path in (recorded, tmp_path / "back.mcap")
    )
    assert after == before
    assert [topic for topic, *_ in before] == ["/imu"] * 3 + ["/map"] * 3 + ["/scan"] * 3 + [
        "/wheel_odom"
    ] * 2
    scans = read_all(tmp_path / "there" / name, "/scan")
    ahead_m = [np.asarray(scan.ranges)[len(scan.ranges) // 2] for scan in scans]
    assert ahead_m == pytest.approx([2.0, 2.5, 3.0], abs=0.03)
    last = read_all(tmp_path / "there" / name, "/map")[-1]
    assert (last.info.width, last.info.height) == (2, 2)
    np.testing.assert_array_equal(last.data, [FREE, OCCUPIED, UNKNOWN, FREE])


def test_a_folder_has_wheels_and_accelerometer_and_names_the_rest(
    recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    convert_path(recorded, tmp_path / "folder")
    names = {file.name for file in (tmp_path / "folder").iterdir()}
    assert {"wheel_odom.txt", "accelerometer.txt"} <= names
    (line,) = [line for line in caplog.messages if "left out" in line]
    left_out = line.rpartition(": ")[2].split(", ")
    assert {"/scan", "/map"} <= set(left_out)
    assert not {"/wheel_odom", "/imu"} & set(left_out)
