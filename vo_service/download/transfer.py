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

from drivers.errors import InputError, UserFacingError
from vo_service.download.partial_file import PartialFile

TIMEOUT_S = 30.0
CHUNK = 1 << 16
# Before each further attempt, as long as none of them brings anything.
PAUSES_S = (1.0, 2.0, 4.0, 8.0)
_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)")
Progress = Callable[[int, int | None], None]  # bytes that are here, bytes in all


class BrokenOffError(UserFacingError):
    """The server cannot be reached, or not any more. Trying again may help."""


class Answer(Protocol):
    """What is used of an HTTP response."""

    headers: Message

    @property
    def status(self) -> int | None: ...
    def read1(self, size: int, /) -> bytes: ...
    def close(self) -> None: ...


class _SafeRedirects(urllib.request.HTTPRedirectHandler):
    """To other places of the Web only, and never from a protected connection to a plain one."""

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str,
        headers: Message, newurl: str,
    ) -> urllib.request.Request | None:  # fmt: skip
        """See `HTTPRedirectHandler`."""
        if req.type == "https" and not newurl.startswith("https:"):
            raise UserFacingError(
                f"{req.full_url}: leads to {newurl}, without protection; give another source with "
                "--mirror"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


def fetch_patiently(
    url: str, part: PartialFile, progress: Progress, pause: Callable[[float], None] = time.sleep
) -> None:
    """As `fetch`, but after a break it tries again, until several attempts bring nothing.

    A server that cannot be reached at all is not waited for.
    """
    size_at_start, failures = part.size, 0
    while True:
        size = part.size
        try:
            return fetch(url, part, progress)
        except BrokenOffError:
            failures = 0 if part.size > size else failures + 1
            if part.size == size_at_start or failures == len(PAUSES_S):
                raise
            pause(PAUSES_S[failures])


def fetch(url: str, part: PartialFile, progress: Progress) -> None:
    """Bring `part` up to the whole file at `url`; what it holds of this version is not sent again.

    Raises InputError for an address that is of no use, BrokenOffError where trying again may help
    (what has come is kept), UserFacingError for anything else.
    """
    answer = _ask(url, part)
    if not _follows_on(answer, part):
        answer.close()
        part.begin(url, "")
        answer = _ask(url, part)
    try:
        total = _begin(url, answer, part)
        if total is not None:
            part.need(total - part.size + total)  # and as much again once it is unpacked
        progress(part.size, total)
        for data in _chunks(url, answer, part):
            part.append(data)
            progress(part.size, total)
    finally:
        answer.close()
    if total is not None and part.size < total:
        raise _cut_off(url, part, f"the server announced {total} bytes")


def _ask(url: str, part: PartialFile) -> Answer:
    """Ask for what is missing, if it is still the same file, or else for all of it."""
    headers = {"User-Agent": f"kinect-vo/{version('kinect-vo')}", "Accept-Encoding": "identity"}
    mark = part.mark(url)
    if mark:
        headers |= {"Range": f"bytes={part.size}-", "If-Range": mark}
    opener = urllib.request.build_opener(_SafeRedirects)
    try:
        answer: Answer = opener.open(
            urllib.request.Request(url, headers=headers), timeout=TIMEOUT_S
        )
        return answer
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and mark:
            return error
        raise _refused(url, error) from error
    except (http.client.InvalidURL, ValueError) as error:
        raise InputError(f"{url}: is no address: {error}; see --mirror") from error
    except (OSError, http.client.HTTPException) as error:
        raise BrokenOffError(
            f"{url}: cannot be reached: {_reason(error)}; look to the network, or give another "
            "source with --mirror"
        ) from error


def _follows_on(answer: Answer, part: PartialFile) -> bool:
    """Whether the answer is the whole file, or begins where `part` ends."""
    first, total = _range(answer)
    if answer.status == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        return total == part.size  # there is nothing left to send
    return answer.status == http.client.OK or first == part.size


def _begin(url: str, answer: Answer, part: PartialFile) -> int | None:
    """Make `part` ready for what follows; the size of the whole file, where the server says it."""
    if answer.status == http.client.OK:
        part.begin(url, _mark(answer.headers))
        return _number(answer.headers.get("Content-Length", ""))
    if not _follows_on(answer, part):
        raise UserFacingError(
            f"{url}: the server sends another part than it was asked for; give another source "
            "with --mirror"
        )
    return _range(answer)[1]


def _range(answer: Answer) -> tuple[int | None, int | None]:
    """Number of the first byte that is sent, and size of the whole file, as far as it is said."""
    found = _RANGE.fullmatch(answer.headers.get("Content-Range", ""))
    return (_number(found[1] or ""), _number(found[2])) if found else (None, None)


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _chunks(url: str, answer: Answer, part: PartialFile) -> Iterator[bytes]:
    """The body; of an error there is none. Raises BrokenOffError."""
    while answer.status != http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
        try:
            data = answer.read1(CHUNK)  # what is there: nothing is lost when it ends
        except (OSError, http.client.HTTPException) as error:
            raise _cut_off(url, part, _reason(error)) from error
        if not data:
            return
        yield data


def _mark(headers: Message) -> str:
    """The server's mark of this version that a later request may refer to, or none."""
    etag = headers.get("ETag", "")
    return etag if etag and not etag.startswith("W/") else headers.get("Last-Modified", "")


def _cut_off(url: str, part: PartialFile, why: str) -> BrokenOffError:
    return BrokenOffError(
        f"{url}: cut off after {part.size} bytes ({why}); what has come is kept: give the same "
        "command again to go on"
    )


def _refused(url: str, error: urllib.error.HTTPError) -> UserFacingError:
    said = f"{error.code} {http.client.responses.get(error.code, '')}".strip()
    if error.code >= http.client.INTERNAL_SERVER_ERROR:
        return BrokenOffError(f"{url}: the server answers {said}; try again later")
    if error.code in (http.client.NOT_FOUND, http.client.GONE):
        return InputError(f"{url}: is not there ({said}); give another source with --mirror")
    return InputError(f"{url}: the server refuses it ({said}); give another source with --mirror")


def _reason(error: Exception) -> str:
    """The cause in a few words."""
    cause = getattr(error, "reason", error)
    if isinstance(cause, TimeoutError):
        return f"nothing came for {TIMEOUT_S:g} s"
    return str(getattr(cause, "strerror", None) or cause or type(cause).__name__)
