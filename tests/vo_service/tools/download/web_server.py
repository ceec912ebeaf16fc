"""Local file server with configurable answers."""

import io
import tarfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

ETAG = '"first"'


class WebServer:
    """State of a server that serves `content` at every address.

    Attributes:
        answers: answers to the next requests; later requests get the content.
        ranges: Range header of each request, empty without one.
        paths: path of each request.
    """

    def __init__(self, url: str, content: bytes) -> None:
        self.url, self.content, self.etag = url, content, ETAG
        self.answers: list[Answer] = []
        self.ranges: list[str] = []
        self.paths: list[str] = []


class RequestHandler(BaseHTTPRequestHandler):
    site: WebServer

    def do_GET(self) -> None:
        self.site.ranges.append(self.headers.get("Range", ""))
        self.site.paths.append(self.path)
        answer = self.site.answers.pop(0) if self.site.answers else serve_ranges
        answer(self)

    def log_message(self, *args: object) -> None:
        pass

    def start_response(self, status: int, **headers: object) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), str(value))
        self.end_headers()

    def send_body(self, data: bytes) -> None:
        self.wfile.write(data)
        self.wfile.flush()


Answer = Callable[[RequestHandler], None]


def serve_ranges(request: RequestHandler, max_bytes: int | None = None) -> None:
    """Serve as a good server does: ranges of the same version, else the whole file.

    After `max_bytes` of the body the connection is closed.
    """
    site, content = request.site, request.site.content
    first = 0
    if request.headers.get("If-Range") == site.etag:
        first = int(request.headers["Range"].removeprefix("bytes=").rstrip("-"))
    size = len(content)
    if first >= size > 0:
        request.start_response(416, Content_Range=f"bytes */{size}", Content_Length=0)
    elif first:
        span = f"bytes {first}-{size - 1}/{size}"
        request.start_response(206, Content_Range=span, Content_Length=size - first, ETag=site.etag)
    else:
        request.start_response(200, Content_Length=size, ETag=site.etag)
    request.send_body(content[first:][:max_bytes])


def serve_without_ranges(request: RequestHandler) -> None:
    """Serve the whole file for any request, without a validator."""
    request.start_response(200, Content_Length=len(request.site.content))
    request.send_body(request.site.content)


def cut_off(after: int) -> Answer:
    """Answer with the first bytes of the requested range, then close the connection."""
    return partial(serve_ranges, max_bytes=after)


def wrong_length(length: int) -> Answer:
    """Answer with the whole file and another length."""

    def answer(request: RequestHandler) -> None:
        request.start_response(200, Content_Length=length, ETag=request.site.etag)
        request.send_body(request.site.content[:length])

    return answer


def chunked(after: int) -> Answer:
    """Answer in chunks without a length, cut off in the middle of a chunk."""

    def answer(request: RequestHandler) -> None:
        request.start_response(200, Transfer_Encoding="chunked")
        request.send_body(b"%x\r\n" % len(request.site.content) + request.site.content[:after])

    return answer


def status_only(code: int, **headers: object) -> Answer:
    """Answer with an error or a redirection."""
    return lambda request: request.start_response(code, Content_Length=0, **headers)


def serve_wrong_range(request: RequestHandler) -> None:
    """Serve a range that was not requested."""
    size = len(request.site.content)
    request.start_response(206, Content_Range=f"bytes 7-{size - 1}/{size}", Content_Length=size - 7)
    request.send_body(request.site.content[7:])


@contextmanager
def running_server(content: bytes) -> Iterator[WebServer]:
    """Run a server on a free port of 127.0.0.1."""
    handler = type(
        "SiteRequest", (RequestHandler,), {"protocol_version": "HTTP/1.1", "timeout": 20}
    )
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        site = WebServer(f"http://127.0.0.1:{server.server_port}/tum", content)
        handler.site = site  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield site
        finally:
            server.shutdown()
            thread.join()


def pack_folder(folder: Path, name: str) -> bytes:
    """Pack a folder as a .tgz, under another name."""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz", compresslevel=1) as tar:
        tar.add(folder, name)
    return data.getvalue()


def make_tgz(*members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    """Make a .tgz of these members."""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz", compresslevel=1) as tar:
        for member, content in members:
            tar.addfile(member, io.BytesIO(content))
    return data.getvalue()


def make_file_member(name: str, content: bytes = b"x") -> tuple[tarfile.TarInfo, bytes]:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    return member, content


def make_special_member(name: str, kind: bytes, target: str = "") -> tuple[tarfile.TarInfo, bytes]:
    """Make a member such as a link, a device or a folder."""
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, target
    return member, b""
