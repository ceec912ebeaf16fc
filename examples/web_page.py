"""Serve a page with live video and the trajectory: http://127.0.0.1:8000, for one browser.

Usage: python web_page.py [PORT [ENDPOINT]]
"""

import sys
from http.server import BaseHTTPRequestHandler, HTTPServer

from vo_service import FrameClient

port, endpoint = [*sys.argv[1:], *("8000", "tcp/127.0.0.1:7450")[len(sys.argv) - 1 :]]
PAGE = b"""<img id=i><canvas id=c width=480 height=480></canvas><script>async function next() {
const answer = await fetch("/frame"), [x, y] = answer.headers.get("X-Pose").split(" ");
i.src = URL.createObjectURL(await answer.blob()); i.onload = () => URL.revokeObjectURL(i.src);
c.getContext("2d").fillRect(240 - 60 * y, 240 - 60 * x, 2, 2); next()} next()</script>"""


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        frame = next(frames) if self.path == "/frame" else None
        self.send_response(200)
        self.send_header("Content-Type", "image/jpeg" if frame else "text/html")
        self.send_header("X-Pose", " ".join(map(str, frame.pose.position_m)) if frame else "")
        self.end_headers()
        self.wfile.write(frame.color_jpeg if frame else PAGE)


with FrameClient(connect=endpoint) as client:
    frames = client.frames(timeout_s=10.0, depth=False, compressed=True)
    HTTPServer(("127.0.0.1", int(port)), Handler).serve_forever()
