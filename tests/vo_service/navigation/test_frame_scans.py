"""The scan of each frame: made once, for whoever asks, by kernels that are loaded besides."""

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import PlaybackMode
from drivers.ros_messages.sensors import LaserScanMessage
from tests.vo_service.navigation.views import mounted, update_of, wall_on_floor
from tests.waiting import wait_until
from vo_service.app import OutputsConfig, open_scans
from vo_service.config import Config, MountingConfig
from vo_service.config_tables import RerunConfig, ScanConfig, ZenohConfig
from vo_service.kernels import compilation
from vo_service.navigation.frame_scans import FrameScans
from vo_service.navigation.robot_scan import RobotScanner
from vo_service.types.odometry_update import OdometryUpdate, add_no_scan

MOUNT = mounted(0.5, 10.0)
FRAME = wall_on_floor(MOUNT, 2.0)


def update_at(stamp_s: float) -> OdometryUpdate:
    return update_of(FRAME, MOUNT, stamp_s)


@pytest.fixture
def scanned(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The stamps of the scans that were computed."""
    stamps_s: list[float] = []
    message = RobotScanner.message

    def counted(
        scanner: RobotScanner, update: OdometryUpdate, scan_time_s: float
    ) -> LaserScanMessage:
        stamps_s.append(update.stamp_s)
        return message(scanner, update, scan_time_s)

    monkeypatch.setattr(RobotScanner, "message", counted)
    return stamps_s


def test_a_scan_is_computed_once_for_all_who_ask_and_not_without(scanned: list[float]) -> None:
    scans = FrameScans(ScanConfig(), MOUNT)
    scans.load()
    updates = [scans.add_to(update_at(10.0 + 0.1 * number)) for number in range(3)]
    asked = updates[::2]
    with ThreadPoolExecutor(8) as readers:
        messages = list(readers.map(lambda update: update.scan.message(), asked * 20))
    assert sorted(scanned) == [update.stamp_s for update in asked]
    assert len({id(message) for message in messages}) == 2
    copy = replace(updates[0], T_world_camera=np.eye(4))  # as the mapper makes it
    assert copy.scan.message() is updates[0].scan.message()


def test_the_scan_time_is_that_of_the_frames_whoever_asks() -> None:
    scans = FrameScans(ScanConfig(), MOUNT)
    scans.load()
    updates = [scans.add_to(update_at(stamp_s)) for stamp_s in (10.0, 10.1, 10.2, 15.0)]
    messages = [update.scan.message() for update in reversed(updates)]
    times_s = [message.scan_time_s for message in messages if message is not None]
    assert times_s == pytest.approx([0.0, 0.1, 0.1, 0.0])


def test_kernels_are_loaded_once_on_a_thread_of_their_own_when_a_scan_is_wanted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads: list[threading.Thread] = []
    finish = threading.Event()

    def warm_up() -> None:
        threads.append(threading.current_thread())
        finish.wait(60.0)

    monkeypatch.setattr(RobotScanner, "warm_up", warm_up)
    scans = FrameScans(ScanConfig(), MOUNT)
    updates = [scans.add_to(update_at(10.0 + number)) for number in range(3)]
    assert not threads
    assert [update.scan.message() for update in updates] == [None] * 3
    finish.set()
    wait_until(lambda: updates[0].scan.message() is not None)
    assert len(threads) == 1
    assert threads[0] is not threading.current_thread()


def test_kernels_are_compiled_by_other_processes_before_they_are_loaded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps: list[str] = []
    monkeypatch.setattr(compilation, "ensure_compiled", lambda parts, _: steps.extend(parts))
    monkeypatch.setattr(RobotScanner, "warm_up", lambda: steps.append("load"))
    FrameScans(ScanConfig(), MOUNT).load()
    assert steps == ["scan", "load"]


def test_kernels_that_cannot_be_loaded_are_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def warm_up() -> None:
        raise OSError("no space left")

    monkeypatch.setattr(RobotScanner, "warm_up", warm_up)
    update = FrameScans(ScanConfig(), MOUNT).add_to(update_at(10.0))
    assert update.scan.message() is None
    wait_until(lambda: "cannot be loaded: no space left" in caplog.text)
    assert update.scan.message() is None


def test_a_mounting_on_the_floor_is_a_warning_once_the_scan_is_wanted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    text = "set translation_m to its position above the floor"
    scans = FrameScans(ScanConfig(), mounted(0.0))
    update = scans.add_to(update_at(10.0))
    assert not update.scan.is_above_floor
    assert text not in caplog.text
    update.scan.message()
    wait_until(lambda: text in caplog.text)


ROBOT = MountingConfig(translation_m=(0.0, 0.0, 0.5))
PUBLISHED = OutputsConfig(PlaybackMode.REALTIME, ZenohConfig())
RECORDED = OutputsConfig(PlaybackMode.LOCKSTEP, None, mcap=Path("a.mcap"))
DRAWN = OutputsConfig(PlaybackMode.LOCKSTEP, None, rerun=RerunConfig(targets=("a.rrd",)))


@pytest.mark.parametrize(
    ("config", "outputs", "is_loaded"),
    [
        (Config(), PUBLISHED, False),
        (Config(), RECORDED, False),
        (Config(T_base_camera=ROBOT), PUBLISHED, False),
        (Config(T_base_camera=ROBOT), RECORDED, True),
        (Config(T_base_camera=ROBOT), DRAWN, True),
        (Config(scan=ScanConfig(enabled=True)), PUBLISHED, True),
        (Config(scan=ScanConfig(enabled=True)), replace(PUBLISHED, zenoh=None), False),
        (Config(T_base_camera=ROBOT, scan=ScanConfig(enabled=False)), RECORDED, False),
    ],
)
def test_kernels_are_loaded_before_the_first_frame_if_each_scan_is_wanted(
    config: Config, outputs: OutputsConfig, is_loaded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded: list[bool] = []
    monkeypatch.setattr(FrameScans, "load", lambda _: loaded.append(True))
    add_scan = open_scans(config, outputs)
    assert loaded == [True] * is_loaded
    assert (add_scan is add_no_scan) == (config.scan.enabled is False)


def test_a_service_does_not_import_the_kernels_before_a_scan_is_wanted() -> None:
    program = """
import sys
import vo_service.cli.run
from vo_service.app import OutputsConfig, open_frames, open_scans
from vo_service.config import Config, MountingConfig
from drivers.camera import PlaybackMode

config = Config()
open_scans(config, OutputsConfig(PlaybackMode.REALTIME, config.zenoh))
(frames,) = open_frames(config)
assert "scan" in [topic.name for topic in frames._topics]
frames.close()
kernels = ("depth_rays", "scan", "local_grid")
loaded = [name for name in kernels if f"vo_service.navigation.{name}" in sys.modules]
sys.exit(f"loaded: {loaded}" if loaded else 0)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)
