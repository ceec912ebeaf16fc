"""Download of one file over HTTP into a partial file, which can be resumed at any time."""

import fcntl
import http.client
import json
import os
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import suppress
from email.message import Message
from http.client import HTTPResponse
from importlib.metadata import version
from pathlib import Path
from typing import IO, Self, cast

from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write
from drivers.core.write_errors import WriteError, check_in_place, free_disk_bytes
from vo_service.terminal import announce, announce_if_slow

READ_TIMEOUT_S = 30.0
CHUNK_BYTES = 1 << 16
# Delays before the attempts after failures without progress.
RETRY_DELAYS_S = (1.0, 2.0, 4.0, 8.0)
_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)")
# Is called with the bytes that were received or unpacked, and all if known.
TransferProgress = Callable[[int, int | None], None]


def disk_error(folder: Path, error: OSError) -> WriteError:
    """Return the error for a failure to write below `folder`."""
    return WriteError.of(folder, error, "the partial download is kept")


class PartialFile:
    """Locked file that only grows, with a metadata file beside it.

    The metadata are the address and the server's validator of this version of the file.
    """

    def __init__(self, path: Path) -> None:
        """Open or create the file. Raises UserFacingError on failure or if it is locked."""
        self.path = path
        self._metadata_path = path.with_name(f"{path.name}.json")
        try:
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise disk_error(path.parent, error) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise UserFacingError(
                f"{path}: another kinect-vo is downloading it; wait for it to end"
            ) from error

    @property
    def size(self) -> int:
        """Size, bytes."""
        return os.fstat(self._file.fileno()).st_size

    def validator(self, url: str) -> str:
        """Return the validator of the partial download of `url`; empty if it is not from there."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            metadata = json.loads(self._metadata_path.read_text())
            if metadata["url"] == url and self.size:
                return str(metadata["mark"])
        return ""

    def restart(self, url: str, validator: str) -> None:
        """Truncate the file and store new metadata. Raises UserFacingError."""
        try:
            self._file.truncate(0)
            atomic_write(self._metadata_path, json.dumps({"url": url, "mark": validator}).encode())
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def append(self, data: bytes) -> None:
        """Append data.

        Raises:
            UserFacingError: After writing as much as possible.
        """
        rest = memoryview(data)
        try:
            check_in_place(self._file.fileno(), self.path)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def require_free_space(self, size: int) -> None:
        """Raise UserFacingError unless the disk has room for `size` more bytes."""
        free = free_disk_bytes(self.path.parent)
        if free < size:
            raise UserFacingError(
                f"{self.path.parent}: {size / 1e9:.2f} GB are needed and {free / 1e9:.2f} GB are "
                "free; free some space or name another folder with --output"
            )

    def discard(self) -> None:
        """Remove the file and its metadata."""
        self.path.unlink(missing_ok=True)
        self._metadata_path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self.size == 0:
            self.discard()
        self._file.close()


class TransferInterruptedError(UserFacingError):
    """The server cannot be reached, or the transfer was interrupted. A retry may help."""


class _SafeRedirectHandler(urllib.request.HTTPRedirectHandler):
    """Follow redirects to the web only, and never from https to http."""

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str,
        headers: Message, newurl: str,
    ) -> urllib.request.Request | None:  # fmt: skip
        if req.type == "https" and not newurl.startswith("https:"):
            raise UserFacingError(
                f"{req.full_url}: redirects to {newurl}, which is not encrypted; "
                "use another source with --mirror"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


def fetch_with_retries(url: str, part: PartialFile, on_progress: TransferProgress) -> None:
    """Fetch a file as `fetch` does, with retries until several in a row make no progress.

    There is no retry if the first attempt receives nothing.
    """
    size_at_start, failures = part.size, 0
    while True:
        size = part.size
        try:
            return fetch(url, part, on_progress)
        except TransferInterruptedError:
            failures = 0 if part.size > size else failures + 1
            if part.size == size_at_start or failures == len(RETRY_DELAYS_S):
                raise
            delay_s = RETRY_DELAYS_S[failures]
            announce(f"{url}: interrupted after {part.size} bytes; trying again in {delay_s:g} s")
            time.sleep(delay_s)


def fetch(url: str, part: PartialFile, on_progress: TransferProgress) -> None:
    """Complete `part` to the whole file at `url`, without its existing part of this version.

    Raises:
        InputError: The address is not usable.
        TransferInterruptedError: A retry may help; the received part is kept.
        UserFacingError: Another error.
    """
    response = _send_request(url, part)
    if not _is_resumable(response, part):
        response.close()
        part.restart(url, "")
        response = _send_request(url, part)
    try:
        total = _prepare_part(url, response, part)
        if total is not None:
            # The unpacked files need about as much space as the archive.
            part.require_free_space(total - part.size + total)
        on_progress(part.size, total)
        for data in _read_chunks(url, response, part):
            part.append(data)
            on_progress(part.size, total)
    finally:
        response.close()
    if total is not None and part.size < total:
        raise _interrupted_error(url, part, f"the server announced {total} bytes")


def _send_request(url: str, part: PartialFile) -> HTTPResponse:
    """Request the missing part if the file has not changed, else the whole file."""
    headers = {"User-Agent": f"kinect-vo/{version('kinect-vo')}", "Accept-Encoding": "identity"}
    validator = part.validator(url)
    if validator:
        headers |= {"Range": f"bytes={part.size}-", "If-Range": validator}
    opener = urllib.request.build_opener(_SafeRedirectHandler)
    try:
        request = urllib.request.Request(url, headers=headers)
        with announce_if_slow(f"waiting for {url}"):
            return cast(HTTPResponse, opener.open(request, timeout=READ_TIMEOUT_S))
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and validator:
            return cast(HTTPResponse, error)
        raise _http_error(url, error) from error
    except (http.client.InvalidURL, ValueError) as error:
        raise InputError(f"{url}: is not a valid address: {error}; see --mirror") from error
    except (OSError, http.client.HTTPException) as error:
        raise TransferInterruptedError(
            f"{url}: cannot be reached: {_error_reason(error)}; check the network, or use another "
            "source with --mirror"
        ) from error


def _is_resumable(response: HTTPResponse, part: PartialFile) -> bool:
    """Return True if the response is the whole file or starts where `part` ends."""
    first, total = _content_range(response)
    if response.status == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        return total == part.size  # the file is complete
    return response.status == http.client.OK or first == part.size


def _prepare_part(url: str, response: HTTPResponse, part: PartialFile) -> int | None:
    """Prepare `part` for the data; returns the size of the whole file if known, bytes."""
    if response.status == http.client.OK:
        part.restart(url, _validator(response.headers))
        return _parse_number(response.headers.get("Content-Length", ""))
    if not _is_resumable(response, part):
        raise UserFacingError(
            f"{url}: the server sends another part than requested; use another source with --mirror"
        )
    return _content_range(response)[1]


def _content_range(response: HTTPResponse) -> tuple[int | None, int | None]:
    """Return the first byte's number and the size of the whole file; None if not given."""
    match = _RANGE.fullmatch(response.headers.get("Content-Range", ""))
    return (_parse_number(match[1] or ""), _parse_number(match[2])) if match else (None, None)


def _parse_number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _read_chunks(url: str, response: HTTPResponse, part: PartialFile) -> Iterator[bytes]:
    """Yield the body, nothing for an error. Raises TransferInterruptedError."""
    while response.status != http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        try:
            # read1 returns available data at once, so none is lost at an interruption.
            data = response.read1(CHUNK_BYTES)
        except (OSError, http.client.HTTPException) as error:
            raise _interrupted_error(url, part, _error_reason(error)) from error
        if not data:
            return
        yield data


def _validator(headers: Message) -> str:
    """Return the server's validator of this version for later requests; empty if none."""
    etag = headers.get("ETag", "")
    return etag if etag and not etag.startswith("W/") else headers.get("Last-Modified", "")


def _interrupted_error(url: str, part: PartialFile, reason: str) -> TransferInterruptedError:
    return TransferInterruptedError(
        f"{url}: interrupted after {part.size} bytes ({reason}); the partial download is kept: "
        "run the same command again to resume"
    )


def _http_error(url: str, error: urllib.error.HTTPError) -> UserFacingError:
    status = f"{error.code} {http.client.responses.get(error.code, '')}".strip()
    if error.code >= http.client.INTERNAL_SERVER_ERROR:
        return TransferInterruptedError(f"{url}: the server reports {status}; try again later")
    if error.code in (http.client.NOT_FOUND, http.client.GONE):
        return InputError(f"{url}: does not exist ({status}); use another source with --mirror")
    return InputError(f"{url}: the server refuses it ({status}); use another source with --mirror")


def _error_reason(error: Exception) -> str:
    """Return the cause in a few words."""
    cause = getattr(error, "reason", error)
    if isinstance(cause, TimeoutError):
        return f"no data for {READ_TIMEOUT_S:g} s"
    return str(getattr(cause, "strerror", None) or cause or type(cause).__name__)
