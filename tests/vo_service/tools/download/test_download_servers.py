"""The command ``download`` with good and faulty servers."""

import hashlib
import io
import urllib.request
from email.message import Message
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.tools.download.conftest import FOLDER, NAME, Download, hidden_files
from tests.vo_service.tools.download.web_server import (
    RequestHandler,
    WebServer,
    chunked,
    cut_off,
    running_server,
    serve_without_ranges,
    serve_wrong_range,
    status_only,
    wrong_length,
)
from vo_service import terminal
from vo_service.tools.download import transfer


def test_it_resumes_after_interruptions(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [cut_off(1000), cut_off(0), cut_off(500)]
    assert download(NAME).code == 0
    assert server.ranges == ["", "bytes=1000-", "bytes=1000-", "bytes=1500-"]


def test_a_partial_download_is_kept_for_the_next_time(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [cut_off(1000), *[cut_off(0)] * 2]
    outcome = download(NAME)
    assert (outcome.code, outcome.out) == (1, "")
    *retries, error = outcome.err.splitlines()
    assert [line.rpartition(": ")[2] for line in retries] == [
        "interrupted after 1000 bytes; trying again in 0 s"
    ] * 2
    assert "interrupted after 1000 bytes (the server announced" in error
    assert not (output / FOLDER).exists()
    assert download(NAME).code == 0
    assert server.ranges[-1] == "bytes=1000-"


def test_another_version_of_the_file_is_not_resumed(download: Download, server: WebServer) -> None:
    server.answers = [cut_off(1000), *[status_only(503)] * 2]
    assert "503" in download(NAME).err
    server.etag = '"second"'
    assert download(NAME).code == 0
    assert server.ranges[3:] == ["bytes=1000-"]


def test_a_partial_download_of_another_mirror_is_not_resumed(
    download: Download, server: WebServer, archive: bytes
) -> None:
    server.answers = [cut_off(1000), *[status_only(503)] * 2]
    download(NAME)
    with running_server(archive) as other:
        assert download(NAME, "--mirror", other.url).code == 0
        assert other.ranges == [""]


@pytest.mark.parametrize("answer", [serve_without_ranges, serve_wrong_range])
def test_a_server_without_resumption_restarts(
    download: Download, server: WebServer, answer: object
) -> None:
    server.answers = [cut_off(1000), answer]  # type: ignore[list-item]
    assert download(NAME).code == 0


def test_an_interrupted_chunked_transfer_is_not_complete(
    download: Download, server: WebServer
) -> None:
    server.answers = [chunked(1000)] * 3
    outcome = download(NAME)
    assert outcome.code == 1
    assert "interrupted after 1000 bytes" in outcome.err


def test_a_length_that_is_too_large_keeps_the_file(download: Download, server: WebServer) -> None:
    server.answers = [wrong_length(len(server.content) + 5)]
    assert download(NAME).code == 0
    assert server.ranges == ["", f"bytes={len(server.content)}-"]


@pytest.mark.parametrize("at", [3, 2000, -5])
def test_a_damaged_archive_is_removed_and_downloaded_again(
    download: Download, server: WebServer, archive: bytes, output: Path, at: int
) -> None:
    damaged = bytearray(archive)
    damaged[at] ^= 0xFF
    server.content = bytes(damaged)
    outcome = download(NAME)
    assert (outcome.code, outcome.out) == (1, "")
    assert "the archive is damaged (" in outcome.err
    assert list(output.iterdir()) == []
    server.content = archive
    assert download(NAME).code == 0


def test_a_login_page_and_a_cut_archive_are_damaged(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [wrong_length(5000)]
    assert "the archive is damaged (" in download(NAME).err
    server.content = b"<html>please log in</html>"
    assert "the archive is damaged (Not a gzipped file" in download(NAME).err
    assert hidden_files(output) == []


def test_a_digest_is_checked(download: Download, archive: bytes) -> None:
    wrong = download(NAME, "--sha256", "0" * 64)
    right = hashlib.sha256(archive).hexdigest()
    assert (wrong.code, f"(its SHA-256 is {right})" in wrong.err) == (1, True)
    assert download(NAME, "--sha256", right.upper()).code == 0


@pytest.mark.parametrize(
    ("code", "exit_code", "message"),
    [(404, 2, "does not exist (404 Not Found)"), (403, 2, "refuses it (403 Forbidden)"),
     (416, 2, "refuses it (416"), (500, 1, "the server reports 500")],
)  # fmt: skip
def test_an_error_of_the_server_is_reported_at_once(
    download: Download, server: WebServer, output: Path, code: int, exit_code: int, message: str
) -> None:
    server.answers = [status_only(code)]
    outcome = download(NAME)
    assert (outcome.code, outcome.err.count("\n"), len(server.ranges)) == (exit_code, 1, 1)
    assert f"{server.url}/freiburg1/{FOLDER}.tgz: " in outcome.err
    assert message in outcome.err
    assert list(output.iterdir()) == []


def test_a_redirection_is_followed_but_not_to_files(download: Download, server: WebServer) -> None:
    server.answers = [status_only(302, Location=f"{server.url}/other")]
    assert download(NAME).code == 0
    server.answers = [status_only(302, Location="file:///etc/passwd")]
    outcome = download("fr1/rpy")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def test_a_redirect_from_https_to_http_is_rejected() -> None:
    request = urllib.request.Request("https://host/a.tgz")
    redirects, headers = transfer._SafeRedirectHandler(), Message()
    target = "https://other/a.tgz"
    redirected = redirects.redirect_request(request, io.BytesIO(), 302, "Found", headers, target)
    assert redirected is not None
    assert redirected.full_url == target
    with pytest.raises(UserFacingError, match="redirects to http://other, which is not encrypted"):
        redirects.redirect_request(request, io.BytesIO(), 302, "Found", headers, "http://other")


def test_no_network_is_reported_in_one_line(
    output: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = run_in_process(
        capfd, "download", NAME, "--output", output, "--mirror", "http://127.0.0.1:1/x"
    )
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)
    assert "cannot be reached: Connection refused; check the network" in outcome.err


def test_a_server_that_stops_sending_times_out(
    download: Download, server: WebServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop_sending(request: RequestHandler) -> None:
        request.start_response(200, Content_Length=9999)
        request.send_body(b"x")
        request.rfile.read(1)  # until the client disconnects

    monkeypatch.setattr(transfer, "READ_TIMEOUT_S", 0.2)
    server.answers = [stop_sending] * 3
    assert "interrupted after 1 bytes (no data for 0.2 s)" in download(NAME).err


def test_a_wait_for_the_server_is_announced(
    download: Download, server: WebServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stay_silent(request: RequestHandler) -> None:
        request.rfile.read(1)  # until the client disconnects

    monkeypatch.setattr(terminal, "SLOW_AFTER_S", 0.01)
    monkeypatch.setattr(transfer, "READ_TIMEOUT_S", 0.5)
    server.answers = [stay_silent] * 3
    waiting, error = download(NAME).err.splitlines()
    assert waiting.startswith(f"kinect-vo: info: waiting for {server.url}")
    assert "cannot be reached" in error


def test_control_characters_of_a_server_do_not_reach_the_terminal(
    download: Download, server: WebServer
) -> None:
    server.answers = [lambda request: request.send_body(b"\x1b[31m garbage\r\n\r\n")]
    error = download(NAME).err
    assert error.removesuffix("\n").isprintable()
