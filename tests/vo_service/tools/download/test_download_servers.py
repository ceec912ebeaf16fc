"""``download`` from servers of every kind."""

import hashlib
import io
import urllib.request
from email.message import Message
from pathlib import Path

import pytest

from drivers.core.errors import UserFacingError
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
from vo_service.tools.download import transfer


def test_it_goes_on_where_it_was_cut_off(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [cut_off(1000), cut_off(0), cut_off(500)]
    assert download(NAME).code == 0
    assert server.asked == ["", "bytes=1000-", "bytes=1000-", "bytes=1500-"]


def test_what_has_come_is_kept_for_the_next_time(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [cut_off(1000), *[cut_off(0)] * 2]
    outcome = download(NAME)
    assert (outcome.code, outcome.out) == (1, "")
    assert "cut off after 1000 bytes" in outcome.err
    assert outcome.err.count("\n") == 1
    assert not (output / FOLDER).exists()
    assert download(NAME).code == 0
    assert server.asked[-1] == "bytes=1000-"


def test_another_version_of_the_file_is_not_gone_on_with(
    download: Download, server: WebServer
) -> None:
    server.answers = [cut_off(1000), *[status_only(503)] * 2]
    assert "503" in download(NAME).err
    server.etag = '"second"'
    assert download(NAME).code == 0
    assert server.asked[3:] == ["bytes=1000-"]


def test_the_beginning_from_another_mirror_is_not_gone_on_with(
    download: Download, server: WebServer, archive: bytes
) -> None:
    server.answers = [cut_off(1000), *[status_only(503)] * 2]
    download(NAME)
    with running_server(archive) as other:
        assert download(NAME, "--mirror", other.url).code == 0
        assert other.asked == [""]


@pytest.mark.parametrize("answer", [serve_without_ranges, serve_wrong_range])
def test_a_server_that_does_not_go_on_begins_again(
    download: Download, server: WebServer, answer: object
) -> None:
    server.answers = [cut_off(1000), answer]  # type: ignore[list-item]
    assert download(NAME).code == 0


def test_a_transfer_in_chunks_that_is_cut_off_is_no_end(
    download: Download, server: WebServer
) -> None:
    server.answers = [chunked(1000)] * 3
    outcome = download(NAME)
    assert outcome.code == 1
    assert "cut off after 1000 bytes" in outcome.err


def test_a_length_that_is_too_great_costs_nothing(download: Download, server: WebServer) -> None:
    server.answers = [wrong_length(len(server.content) + 5)]
    assert download(NAME).code == 0
    assert server.asked == ["", f"bytes={len(server.content)}-"]


def test_a_length_that_is_too_small_is_a_damaged_archive(
    download: Download, server: WebServer, output: Path
) -> None:
    server.answers = [wrong_length(5000)]
    outcome = download(NAME)
    assert outcome.code == 1
    assert "the archive is damaged (" in outcome.err
    assert hidden_files(output) == []


@pytest.mark.parametrize("at", [3, 2000, -5])
def test_a_damaged_archive_is_removed_and_comes_whole_the_next_time(
    download: Download, server: WebServer, archive: bytes, output: Path, at: int
) -> None:
    broken = bytearray(archive)
    broken[at] ^= 0xFF
    server.content = bytes(broken)
    outcome = download(NAME)
    assert (outcome.code, outcome.out) == (1, "")
    assert "the archive is damaged (" in outcome.err
    assert list(output.iterdir()) == []
    server.content = archive
    assert download(NAME).code == 0


def test_a_login_page_is_no_archive(download: Download, server: WebServer) -> None:
    server.content = b"<html>please log in</html>"
    assert "the archive is damaged (Not a gzipped file" in download(NAME).err


def test_a_digest_is_heeded(download: Download, archive: bytes) -> None:
    wrong = download(NAME, "--sha256", "0" * 64)
    right = hashlib.sha256(archive).hexdigest()
    assert (wrong.code, f"(its SHA-256 is {right})" in wrong.err) == (1, True)
    assert download(NAME, "--sha256", right.upper()).code == 0


@pytest.mark.parametrize(
    ("code", "exit_code", "told"),
    [(404, 2, "is not there (404 Not Found)"), (403, 2, "refuses it (403 Forbidden)"),
     (416, 2, "refuses it (416"), (500, 1, "the server answers 500")],
)  # fmt: skip
def test_an_error_of_the_server_is_told_at_once(
    download: Download, server: WebServer, output: Path, code: int, exit_code: int, told: str
) -> None:
    server.answers = [status_only(code)]
    outcome = download(NAME)
    assert (outcome.code, outcome.err.count("\n"), len(server.asked)) == (exit_code, 1, 1)
    assert f"{server.url}/freiburg1/{FOLDER}.tgz: " in outcome.err
    assert told in outcome.err
    assert list(output.iterdir()) == []


def test_a_redirection_is_followed_but_not_to_files(download: Download, server: WebServer) -> None:
    server.answers = [status_only(302, Location=f"{server.url}/other")]
    assert download(NAME).code == 0
    server.answers = [status_only(302, Location="file:///etc/passwd")]
    outcome = download("fr1/rpy")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def test_a_protected_connection_is_not_left_for_a_plain_one() -> None:
    request = urllib.request.Request("https://host/a.tgz")
    redirects, headers = transfer._SafeRedirectHandler(), Message()
    where = "https://other/a.tgz"
    followed = redirects.redirect_request(request, io.BytesIO(), 302, "Found", headers, where)
    assert followed is not None
    assert followed.full_url == where
    with pytest.raises(UserFacingError, match="leads to http://other, without protection"):
        redirects.redirect_request(request, io.BytesIO(), 302, "Found", headers, "http://other")


def test_no_network_is_told_in_one_line(output: Path, capfd: pytest.CaptureFixture[str]) -> None:
    outcome = run_in_process(
        capfd, "download", NAME, "--output", output, "--mirror", "http://127.0.0.1:1/x"
    )
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)
    assert "cannot be reached: Connection refused; look to the network" in outcome.err


def test_a_server_that_falls_silent_is_given_up(
    download: Download, server: WebServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(request: RequestHandler) -> None:
        request.start_response(200, Content_Length=9999)
        request.send_body(b"x")
        request.rfile.read(1)  # until the other side has gone

    monkeypatch.setattr(transfer, "READ_TIMEOUT_S", 0.2)
    server.answers = [silent] * 3
    assert "cut off after 1 bytes (nothing came for 0.2 s)" in download(NAME).err
