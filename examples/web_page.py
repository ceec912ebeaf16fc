"""Serve a page with live video and the trajectory: http://127.0.0.1:8000, for one browser.

Usage: python web_page.py [PORT [ENDPOINT]]
"""

import sys
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, HTTPServer

from vo_service import Frame, FrameClient, FrameUnavailable, InputError

port, endpoint = [*sys.argv[1:3], *("8000", "tcp/127.0.0.1:7450")[len(sys.argv) - 1 :]]
if not port.isdecimal():
    sys.exit(__doc__)
PAGE = b"""<img id=i><canvas id=c width=480 height=480></canvas><p id=p><script>
async function next() { const answer = await fetch("/frame"); p.textContent = "";
if (!answer.ok) { p.textContent = await answer.text(); return next() }
const [x, y] = answer.headers.get("X-Pose").split(" ");
i.src = URL.createObjectURL(await answer.blob()); i.onload = () => URL.revokeObjectURL(i.src);
c.getContext("2d").fillRect(240 - 60 * y, 240 - 60 * x, 2, 2); next()} next()</script>"""


def newest_frames() -> Iterator[Frame | str]:
    """Yield frames, and every two seconds without one the reason."""
    while True:
        try:
            yield from client.frames(timeout_s=2.0, depth=False, compressed=True)
        except FrameUnavailable as error:
            yield str(error)


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path != "/frame":
            self.answer(200, "text/html", PAGE)
        elif isinstance(frame := next(frames), str):
            self.answer(503, "text/plain", frame.encode())
        else:
            position = " ".join(map(str, frame.pose.position_m))
            self.answer(200, "image/jpeg", frame.color_jpeg, position)

    def answer(self, code: int, kind: str, body: bytes, position: str = "") -> None:
        with suppress(ConnectionError):  # the browser may have left
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("X-Pose", position)
            self.end_headers()
            self.wfile.write(body)


try:
    with FrameClient(connect=endpoint) as client:
        frames = newest_frames()
        HTTPServer(("127.0.0.1", int(port)), Handler).serve_forever()
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
