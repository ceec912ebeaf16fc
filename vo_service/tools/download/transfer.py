"""One file over HTTP, gone on with where it was cut off: the standard library's client."""

import http.client
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from email.message import Message
from importlib.metadata import version
from typing import IO, Protocol

from drivers.core.errors import InputError, UserFacingError
from vo_service.tools.download.partial_file import PartialFile

READ_TIMEOUT_S = 30.0
CHUNK_BYTES = 1 << 16
# Before each further attempt, as long as none of them brings anything.
RETRY_DELAYS_S = (1.0, 2.0, 4.0, 8.0)
_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)")
TransferProgress = Callable[[int, int | None], None]  # bytes that are here, bytes in all


class TransferInterruptedError(UserFacingError):
    """The server cannot be reached, or not any more. Trying again may help."""


class HttpResponse(Protocol):
    """What is used of an HTTP response."""

    headers: Message

    @property
    def status(self) -> int | None: ...
    def read1(self, size: int, /) -> bytes: ...
    def close(self) -> None: ...


class _SafeRedirectHandler(urllib.request.HTTPRedirectHandler):
    """To other places of the Web only, and never from a protected connection to a plain one."""

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str,
        headers: Message, newurl: str,
    ) -> urllib.request.Request | None:  # fmt: skip
        if req.type == "https" and not newurl.startswith("https:"):
            raise UserFacingError(
                f"{req.full_url}: leads to {newurl}, without protection; give another source with "
                "--mirror"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


def fetch_with_retries(
    url: str,
    part: PartialFile,
    on_progress: TransferProgress,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """As `fetch`, but after a break it tries again, until several attempts bring nothing.

    A server that cannot be reached at all is not waited for.
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
            sleep(RETRY_DELAYS_S[failures])


def fetch(url: str, part: PartialFile, on_progress: TransferProgress) -> None:
    """Bring `part` up to the whole file at `url`; what it holds of this version is not sent again.

    Raises InputError for an address that is of no use, BrokenOffError where trying again may help
    (what has come is kept), UserFacingError for anything else.
    """
    answer = _send_request(url, part)
    if not _is_resumable(answer, part):
        answer.close()
        part.restart(url, "")
        answer = _send_request(url, part)
    try:
        total = _prepare_part(url, answer, part)
        if total is not None:
            part.require_free_space(
                total - part.size + total
            )  # and as much again once it is unpacked
        on_progress(part.size, total)
        for data in _read_chunks(url, answer, part):
            part.append(data)
            on_progress(part.size, total)
    finally:
        answer.close()
    if total is not None and part.size < total:
        raise _interrupted_error(url, part, f"the server announced {total} bytes")


def _send_request(url: str, part: PartialFile) -> HttpResponse:
    """Ask for what is missing, if it is still the same file, or else for all of it."""
    headers = {"User-Agent": f"kinect-vo/{version('kinect-vo')}", "Accept-Encoding": "identity"}
    mark = part.validator(url)
    if mark:
        headers |= {"Range": f"bytes={part.size}-", "If-Range": mark}
    opener = urllib.request.build_opener(_SafeRedirectHandler)
    try:
        answer: HttpResponse = opener.open(
            urllib.request.Request(url, headers=headers), timeout=READ_TIMEOUT_S
        )
        return answer
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and mark:
            return error
        raise _http_error(url, error) from error
    except (http.client.InvalidURL, ValueError) as error:
        raise InputError(f"{url}: is no address: {error}; see --mirror") from error
    except (OSError, http.client.HTTPException) as error:
        raise TransferInterruptedError(
            f"{url}: cannot be reached: {_error_reason(error)}; look to the network, or give another "
            "source with --mirror"
        ) from error


def _is_resumable(response: HttpResponse, part: PartialFile) -> bool:
    """Whether the answer is the whole file, or begins where `part` ends."""
    first, total = _content_range(response)
    if response.status == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        return total == part.size  # there is nothing left to send
    return response.status == http.client.OK or first == part.size


def _prepare_part(url: str, response: HttpResponse, part: PartialFile) -> int | None:
    """Make `part` ready for what follows; the size of the whole file, where the server says it."""
    if response.status == http.client.OK:
        part.restart(url, _validator(response.headers))
        return _parse_number(response.headers.get("Content-Length", ""))
    if not _is_resumable(response, part):
        raise UserFacingError(
            f"{url}: the server sends another part than it was asked for; give another source "
            "with --mirror"
        )
    return _content_range(response)[1]


def _content_range(response: HttpResponse) -> tuple[int | None, int | None]:
    """Number of the first byte that is sent, and size of the whole file, as far as it is said."""
    found = _RANGE.fullmatch(response.headers.get("Content-Range", ""))
    return (_parse_number(found[1] or ""), _parse_number(found[2])) if found else (None, None)


def _parse_number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _read_chunks(url: str, response: HttpResponse, part: PartialFile) -> Iterator[bytes]:
    """The body; of an error there is none. Raises BrokenOffError."""
    while response.status != http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        try:
            data = response.read1(CHUNK_BYTES)  # what is there: nothing is lost when it ends
        except (OSError, http.client.HTTPException) as error:
            raise _interrupted_error(url, part, _error_reason(error)) from error
        if not data:
            return
        yield data


def _validator(headers: Message) -> str:
    """The server's mark of this version that a later request may refer to, or none."""
    etag = headers.get("ETag", "")
    return etag if etag and not etag.startswith("W/") else headers.get("Last-Modified", "")


def _interrupted_error(url: str, part: PartialFile, reason: str) -> TransferInterruptedError:
    return TransferInterruptedError(
        f"{url}: cut off after {part.size} bytes ({reason}); what has come is kept: give the same "
        "command again to go on"
    )


def _http_error(url: str, error: urllib.error.HTTPError) -> UserFacingError:
    said = f"{error.code} {http.client.responses.get(error.code, '')}".strip()
    if error.code >= http.client.INTERNAL_SERVER_ERROR:
        return TransferInterruptedError(f"{url}: the server answers {said}; try again later")
    if error.code in (http.client.NOT_FOUND, http.client.GONE):
        return InputError(f"{url}: is not there ({said}); give another source with --mirror")
    return InputError(f"{url}: the server refuses it ({said}); give another source with --mirror")


def _error_reason(error: Exception) -> str:
    """The cause in a few words."""
    cause = getattr(error, "reason", error)
    if isinstance(cause, TimeoutError):
        return f"nothing came for {READ_TIMEOUT_S:g} s"
    return str(getattr(cause, "strerror", None) or cause or type(cause).__name__)
