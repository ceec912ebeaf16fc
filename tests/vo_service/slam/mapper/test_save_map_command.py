"""The command `save-map` of the service over Zenoh."""

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import forked_process
from tests.vo_service.reconstruction.ply_reader import read_ply
from tests.vo_service.service_process import START_TIMEOUT_S
from tests.vo_service.service_runner import CAMERA, ServiceRunner, service_runner

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

SMALL = (
    '\n[map]\nvoxel_m = 0.1\nmesh_memory_mb = 50\n[log]\nlevel = "info"\n'
    "[recorder]\nenabled = false\n"
)


@pytest.fixture
def runner(render_cache: Path, kernels: None, tmp_path: Path) -> Iterator[ServiceRunner]:
    with service_runner(tmp_path / "runner", render_cache, CAMERA + SMALL) as runner:
        yield runner


def send_map_command(
    runner: ServiceRunner, name: str, command_name: str = "save-map"
) -> "subprocess.CompletedProcess[str]":
    """Run `kinect-vo command`."""
    at = f"tcp/127.0.0.1:{runner.service.port}"
    command = ("command", command_name, f"name={name}", "--connect", at)
    return forked_process.run([*forked_process.KINECT_VO, *command])


def test_a_map_is_saved_on_command_while_poses_continue(runner: ServiceRunner) -> None:
    service = runner.start()
    service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
    service.wait_for_status(
        lambda status: status["map"]["mesh_keyframes"] == 1
    )  # the camera stands still
    first = len(service.received.poses)
    answer = send_map_command(runner, "kitchen")
    file = runner.state_folder / "maps" / "kitchen.ply"
    assert json.loads(answer.stdout) == {"file": str(file), "keyframes": 1}
    service.wait_for_status(lambda status: status["map"]["saved"] == str(file))
    assert len(service.received.poses) > first
    assert service.status["map"]["saving"] == ""
    assert len(read_ply(file).vertices_m) > 100
    assert "triangles from 1 keyframes" in service.log
    again = send_map_command(runner, "kitchen")
    assert again.returncode == 1
    assert "map 'kitchen' already exists; choose another name (not-possible)" in again.stderr
    assert send_map_command(runner, "../kitchen").returncode == 2
    keyframes = str(file.with_suffix(".keyframes"))
    assert json.loads(send_map_command(runner, "kitchen", "load-map").stdout) == {"file": keyframes}
    service.wait_for_status(lambda status: status["map"]["loaded"] == keyframes)
    service.wait_for_status(
        lambda status: status["map"]["keyframes"] == 2
    )  # that of the map, and what is seen now
    assert {(pose.state, pose.epoch) for pose in service.received.poses} == {("tracking", 0)}
    assert service.stop() == 0
    runner.check()
