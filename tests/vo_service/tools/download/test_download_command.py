"""``download``: what a user gets, whatever the server does."""

import io
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
from vo_service.terminal import Terminal
from vo_service.tools.download import partial_file
from vo_service.tools.download.progress import DownloadProgress


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


def test_one_that_is_there_already_is_left_alone(download: Download, server: WebServer) -> None:
    first = download(NAME)
    again = download(NAME, NAME)
    assert (again.code, again.out) == (0, first.out * 2)
    assert again.err.count(f"kinect-vo: info: {NAME}: there already; to have it anew, remove") == 2
    assert len(server.asked) == 1


def test_a_full_disk_keeps_what_has_come(
    download: Download, server: WebServer, output: Path
) -> None:
    with limit_file_size(1000):
        outcome = download(NAME)
    assert outcome.code == 1
    assert f"{output}: the disk is full" in outcome.err
    assert download(NAME).code == 0
    assert server.asked == ["", "bytes=1000-"]


def test_a_disk_without_room_for_it_is_told_before_it_comes(
    download: Download, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def usage(path: Path) -> SimpleNamespace:
        return SimpleNamespace(total=10**12, free=1000)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    outcome = download(NAME)
    assert outcome.code == 1
    assert "GB are needed and 0.00 GB are free" in outcome.err


def test_a_folder_that_cannot_be_made_is_told(
    download: Download, server: WebServer, output: Path
) -> None:
    output.write_text("a file")
    outcome = download(NAME)
    assert (outcome.code, server.asked) == (2, [])
    assert f"{output}: cannot be created: File exists; name another with --output" in outcome.err


def test_two_at_once_do_not_mix(download: Download, server: WebServer, output: Path) -> None:
    output.mkdir()
    with partial_file.PartialFile(output / f".{FOLDER}.tgz.part"):
        outcome = download(NAME)
    assert "another kinect-vo is downloading it" in outcome.err
    assert server.asked == []


@pytest.mark.subprocess
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interruption_is_at_once_and_keeps_what_has_come(
    server: WebServer, output: Path, number: signal.Signals, code: int
) -> None:
    def slow(request: RequestHandler) -> None:
        request.start_response(200, Content_Length=len(server.content), ETag=server.etag)
        request.send_body(server.content[:1000])
        request.rfile.read(1)

    server.answers = [slow]
    command = [*KINECT_VO, "download", NAME, "--mirror", server.url, "--output", str(output)]
    with ForkedProcess(command, stderr=subprocess.PIPE, text=True) as process:
        part = output / f".{FOLDER}.tgz.part"
        wait_until(lambda: part.exists() and part.stat().st_size == 1000)
        process.send_signal(number)
        _, said = process.communicate()
    assert (process.returncode, said.count("\n")) == (code, 1)
    assert "interrupted; what has come is kept" in said


def test_what_a_killed_one_was_unpacking_is_cleared_away(download: Download, output: Path) -> None:
    remains = output / f".{FOLDER}.unpacking"
    remains.mkdir(parents=True)
    (remains / "half").write_text("a file")
    assert download(NAME).code == 0
    assert hidden_files(output) == []


def test_nothing_is_asked_of_anybody_for_a_name_that_is_wrong(
    download: Download, server: WebServer, output: Path
) -> None:
    outcome = download(NAME, "fr1/tedy")
    assert (outcome.code, server.asked, output.exists()) == (2, [], False)
    assert "no sequence 'fr1/tedy'; did you mean fr1/teddy" in outcome.err


@pytest.mark.parametrize(
    ("given", "told"),
    [((), "which sequence?"), ((NAME, "fr1/rpy", "--sha256", "a" * 64), "one by one"),
     ((NAME, "--mirror", "ftp://host/"), "is no address"),
     ((NAME, "--sha256", "abc"), "64 digits")],
)  # fmt: skip
def test_what_makes_no_sense_is_told(
    download: Download, server: WebServer, given: tuple[str, ...], told: str
) -> None:
    outcome = download(*given)
    assert (outcome.code, outcome.err.count("\n"), server.asked) == (2, 1, [])
    assert told in outcome.err


def test_the_list_names_every_sequence_and_asks_nobody(
    download: Download, server: WebServer
) -> None:
    outcome = download("--list")
    assert len(outcome.out.splitlines()) == 1 + 47 + 33
    assert "fr1/floor " in outcome.out
    assert server.asked == []


class _Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_person_sees_how_far_it_is_and_how_long_it_takes() -> None:
    screen, now_s = _Screen(), iter([0.0, 10.0, 10.0, 10.0, 20.0, 20.0, 30.0, 30.0])
    meter = DownloadProgress(Terminal(screen), NAME, lambda: next(now_s))
    meter.show_transfer(100_000_000, 400_000_000)
    meter.show_transfer(200_000_000, 400_000_000)
    assert "fr1/xyz: 200 of 400 MB (50%), 10.0 MB/s, 20 s left" in screen.getvalue()
    meter.show_unpacking(100, 400)
    assert screen.getvalue().endswith("fr1/xyz: unpacking (25%)")
