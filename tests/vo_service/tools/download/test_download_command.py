"""The command ``download``."""

import shutil
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.tum.folder import open_tum_folder
from tests.conftest import FRAMES
from tests.forked_process import KINECT_VO, ForkedProcess
from tests.full_disk import limit_file_size
from tests.vo_service.tools.download.conftest import FOLDER, NAME, Download, hidden_files
from tests.vo_service.tools.download.web_server import RequestHandler, WebServer
from tests.waiting import wait_until
from vo_service.tools.download import transfer


def test_a_sequence_is_in_its_folder_and_can_be_replayed(
    download: Download, server: WebServer, recording: Path, output: Path
) -> None:
    outcome = download(NAME)
    assert (outcome.code, outcome.err, outcome.out) == (0, "", f"{output / FOLDER}\n")
    assert server.paths == ["/tum/freiburg1/rgbd_dataset_freiburg1_xyz.tgz"]
    assert hidden_files(output) == []
    names = {path.relative_to(recording) for path in recording.rglob("*")}
    assert {path.relative_to(output / FOLDER) for path in (output / FOLDER).rglob("*")} == names
    assert len(open_tum_folder(output / FOLDER, None).frames.pairs) == FRAMES


def test_an_existing_sequence_does_not_change(download: Download, server: WebServer) -> None:
    first = download(NAME)
    again = download(NAME, NAME)
    assert (again.code, again.out) == (0, first.out * 2)
    assert again.err.count(f"kinect-vo: info: {NAME}: exists; to download it again, remove") == 2
    assert len(server.ranges) == 1


def test_a_full_disk_keeps_the_partial_download(
    download: Download, server: WebServer, output: Path
) -> None:
    with limit_file_size(1000):
        outcome = download(NAME)
    assert outcome.code == 1
    assert f"{output}: the disk is full" in outcome.err
    assert download(NAME).code == 0
    assert server.ranges == ["", "bytes=1000-"]


def test_missing_disk_space_is_reported_before_the_transfer(
    download: Download, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def usage(path: Path) -> SimpleNamespace:
        return SimpleNamespace(total=10**12, free=1000)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    outcome = download(NAME)
    assert outcome.code == 1
    assert "GB are needed and 0.00 GB are free" in outcome.err


def test_a_second_download_at_the_same_time_is_rejected(
    download: Download, server: WebServer, output: Path
) -> None:
    output.mkdir()
    with transfer.PartialFile(output / f".{FOLDER}.tgz.part"):
        outcome = download(NAME)
    assert "another kinect-vo is downloading it" in outcome.err
    assert server.ranges == []


@pytest.mark.subprocess
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interruption_keeps_the_partial_download(
    server: WebServer, output: Path, number: signal.Signals, code: int
) -> None:
    def answer_slowly(request: RequestHandler) -> None:
        request.start_response(200, Content_Length=len(server.content), ETag=server.etag)
        request.send_body(server.content[:1000])
        request.rfile.read(1)

    server.answers = [answer_slowly]
    command = [*KINECT_VO, "download", NAME, "--mirror", server.url, "--output", str(output)]
    with ForkedProcess(command, stderr=subprocess.PIPE, text=True) as process:
        part = output / f".{FOLDER}.tgz.part"
        wait_until(lambda: part.exists() and part.stat().st_size == 1000)
        process.send_signal(number)
        _, message = process.communicate()
    assert (process.returncode, message.count("\n")) == (code, 1)
    assert "interrupted; run the same command again" in message


def test_remains_of_a_killed_process_are_removed(download: Download, output: Path) -> None:
    temporary = output / f".{FOLDER}.unpacking"
    temporary.mkdir(parents=True)
    (temporary / "half").write_text("a file")
    assert download(NAME).code == 0
    assert hidden_files(output) == []


def test_a_wrong_name_sends_no_request(download: Download, server: WebServer, output: Path) -> None:
    outcome = download(NAME, "fr1/tedy")
    assert (outcome.code, server.ranges, output.exists()) == (2, [], False)
    assert "no sequence 'fr1/tedy'; did you mean fr1/teddy" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((), "which sequence?"), ((NAME, "fr1/rpy", "--sha256", "a" * 64), "one by one"),
     ((NAME, "--mirror", "ftp://host/"), "is not a URL"),
     ((NAME, "--mirror", "http://[::1"), "is not a URL"),
     ((NAME, "--sha256", "abc"), "64 digits")],
)  # fmt: skip
def test_invalid_arguments_are_reported(
    download: Download, server: WebServer, arguments: tuple[str, ...], message: str
) -> None:
    outcome = download(*arguments)
    assert (outcome.code, outcome.err.count("\n"), server.ranges) == (2, 1, [])
    assert message in outcome.err


def test_the_list_names_every_sequence_and_sends_no_request(
    download: Download, server: WebServer
) -> None:
    outcome = download("--list")
    assert len(outcome.out.splitlines()) == 1 + 47 + 33
    assert "fr1/floor " in outcome.out
    assert server.ranges == []
