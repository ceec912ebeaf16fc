"""Surroundings for commands: a cache of their own, one set of compiled kernels, a free port."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.forked_process import forked_probes
from tests.ports import free_port
from tests.vo_service.cli.cli_runner import KinectVo, run_in_process
from tests.vo_service.service_process import NO_MAP_CONFIG
from vo_service.reconstruction import report


@pytest.fixture(autouse=True)
def surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the user's but the compiled kernels, which all processes of the tests share."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    monkeypatch.setenv("OPENCV_LOG_LEVEL", "SILENT")


@pytest.fixture(scope="session", autouse=True)
def fork_probes() -> Iterator[None]:
    """Fork the processes of the doctor's probes, whose start is not what these tests are about."""
    with forked_probes():
        yield


@pytest.fixture
def kinect_vo(capfd: pytest.CaptureFixture[str]) -> KinectVo:
    """Run a command in this process, as `run_in_process` does."""
    return partial(run_in_process, capfd)


@pytest.fixture
def no_top_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty picture of the map from above, whose drawing takes most of a command's time."""
    monkeypatch.setattr(report, "render_top_view", lambda *_: b"")


@pytest.fixture
def blind_recording(copy_recording: Callable[..., Path]) -> Path:
    """A recording without any reading of depth."""
    folder = copy_recording()
    for file in (folder / "depth").iterdir():
        cv2.imwrite(str(file), np.full((240, 320), 65535, np.uint16))
    return folder


@pytest.fixture
def port() -> int:
    """A port of 127.0.0.1 that nobody has."""
    return free_port()


@pytest.fixture
def config(tmp_path: Path, port: int) -> Path:
    """A configuration that publishes on the free port."""
    file = tmp_path / "kinect.toml"
    file.write_text(f'schema = 1\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n{NO_MAP_CONFIG}')
    return file
