"""`record` with the odometry of wheels, which a driver sends meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import Clock
from drivers.playback.camera import RecordingCamera
from drivers.recording.odometry import OdometryRecord
from tests.ports import free_port, is_listening
from tests.vo_service.cli.cli_runner import KinectVo
from tests.vo_service.fakes import ScriptedCamera
from tests.vo_service.outputs.zenoh.query_helpers import connected_session
from tests.vo_service.wheel_odometry.wheel_driver import CURVE, START_S, pose_at, wheel_message
from tests.waiting import wait_until
from vo_service.cli import record
from vo_service.config import Config
from vo_service.config_tables import WheelOdometryConfig, ZenohConfig
from vo_service.wheel_odometry.wheel_odometry import MessageJournal

PAYLOADS = [wheel_message(START_S + 0.1 * k, pose_at(0.1 * k), CURVE) for k in range(3)]


class LiveCamera(ScriptedCamera):
    """A sensor."""

    clock = Clock.MONOTONIC


@pytest.mark.zenoh
def test_messages_are_received_while_a_sensor_is_recorded() -> None:
    port = free_port()
    config = replace(
        Config(),
        zenoh=ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",)),
        wheel_odometry=WheelOdometryConfig(True),
    )
    received: list[OdometryRecord] = []
    with record._receive_wheels(config, LiveCamera()) as journal, connected_session(port) as driver:
        publisher = driver.declare_publisher("kinect/wheel_odom")
        wait_until(lambda: publisher.matching_status.matching)  # type: ignore[attr-defined]
        for payload in PAYLOADS:
            publisher.put(payload)

        def are_received() -> bool:
            received.extend(journal.take())
            return len(received) == len(PAYLOADS)

        wait_until(are_received)
    assert [each.message for each in received] == PAYLOADS
    assert not is_listening(port)


def test_nothing_listens_unless_it_is_enabled() -> None:
    port = free_port()
    config = replace(Config(), zenoh=ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",)))
    with record._receive_wheels(config, LiveCamera()) as journal:
        assert not is_listening(port)
        assert journal.take() == []


@pytest.mark.parametrize("name", ["drive", "drive.mcap"])
def test_received_messages_are_written_with_the_frames(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo, name: str
) -> None:
    @contextmanager
    def receive(*_: object) -> Iterator[MessageJournal]:
        journal = MessageJournal()
        for number, payload in enumerate(PAYLOADS):
            journal.add(OdometryRecord(START_S + 0.1 * number, payload))
        yield journal

    monkeypatch.setattr(record, "_receive_wheels", receive)
    outcome = kinect_vo("record", "--camera", f"tum:{recording}", tmp_path / name)
    assert outcome.code == 0, outcome.err
    camera = RecordingCamera(tmp_path / name)
    assert list(camera.recorded_odometry(["/wheel_odom"])) == PAYLOADS
