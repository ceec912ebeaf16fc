"""Local server with one small recording of the benchmark."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import CommandResult, run_in_process
from tests.vo_service.tools.download.web_server import WebServer, pack_folder, running_server
from vo_service.tools.download import transfer

Download = Callable[..., CommandResult]
NAME = "fr1/xyz"
FOLDER = "rgbd_dataset_freiburg1_xyz"


@pytest.fixture(scope="session")
def archive(recording: Path) -> bytes:
    """Recording as an archive of the benchmark."""
    return pack_folder(recording, FOLDER)


@pytest.fixture(autouse=True)
def no_proxy_or_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use no proxy, and no delay between two attempts."""
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setattr(transfer, "RETRY_DELAYS_S", (0.0, 0.0))


@pytest.fixture
def server(archive: bytes) -> Iterator[WebServer]:
    with running_server(archive) as site:
        yield site


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "recordings"


@pytest.fixture
def download(server: WebServer, output: Path, capfd: pytest.CaptureFixture[str]) -> Download:
    """The download command of a user."""
    return partial(run_in_process, capfd, "download", "--mirror", server.url, "--output", output)


def hidden_files(output: Path) -> list[str]:
    """Return the names of hidden files in the output folder."""
    return sorted(path.name for path in output.iterdir() if path.name.startswith("."))
