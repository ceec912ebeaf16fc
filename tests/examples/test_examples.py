"""Each example, run as its reader would, against a real `kinect-vo run`."""

import csv
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests import forked_process
from tests.conftest import FRAMES
from tests.drivers.freenect.conftest import plug_in
from tests.examples.conftest import EXAMPLES, RATE_HZ, output_of, program
from tests.forked_process import ForkedProcess
from tests.json_schema import schema_errors
from tests.ports import free_port
from tests.simulators.fixtures import SimulateKinect
from tests.vo_service.client.fake_service import find_free_endpoint, running_fake_service
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.types.commands import PauseCommand, ResumeCommand
from vo_service.wheel_odometry.wheel_reading import WheelReading, parse_wheel_reading

pytestmark = pytest.mark.subprocess

NUMBER = r"-?\d+\.?\d*(?:e-?\d+)?"


def finished(name: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """An example that ends by itself."""
    command = [sys.executable, str(EXAMPLES / name), *(str(argument) for argument in arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)


def finished_fork(name: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """The same in a process that has imported all, and waits a tenth of a second for frames.

    Another test starts it.
    """
    text = (EXAMPLES / name).read_text().replace("timeout_s=10.0", "timeout_s=0.1")
    words = (str(argument) for argument in arguments)
    return forked_process.run([sys.executable, "-c", text, *words])


def kinect_vo(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """The command line."""
    return forked_process.run([*forked_process.KINECT_VO, *arguments])


def test_there_is_a_test_for_every_example() -> None:
    text = "".join(file.read_text() for file in Path(__file__).parent.glob("test_*.py"))
    assert [file.name for file in EXAMPLES.glob("*.py") if f'("{file.name}"' not in text] == []


@contextmanager
def again_and_again(tell: Callable[[], None]) -> Iterator[None]:
    """As a service goes on telling while somebody comes to listen."""
    stop = threading.Event()

    def keep_telling() -> None:
        while not stop.wait(1 / RATE_HZ):
            tell()

    thread = threading.Thread(target=keep_telling)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def test_every_frame_of_a_recording_is_printed(recording: Path) -> None:
    done = finished_fork("read_camera.py", f"tum:{recording}")
    assert (done.stderr, done.returncode) == ("", 0)
    assert len(done.stdout.splitlines()) == FRAMES
    assert re.match(r"\d+\.\d{3} s: 320x240, \d\.\d\d m ahead$", done.stdout.splitlines()[0])


def test_frames_of_a_kinect_are_printed_until_ctrl_c(simulate_kinect: SimulateKinect) -> None:
    plug_in(simulate_kinect)
    with program("read_camera.py", "freenect") as lines:
        lines.wait_for_line("^.* 640x480, ")
        lines.interrupt()
        output, code = lines.finish()
        assert ("Traceback" in output, code) == (False, 130)


@pytest.mark.parametrize("name", ["read_camera.py", "odometry.py"])
def test_a_wrong_source_is_one_line(name: str) -> None:
    done = finished_fork(name, "tum:/nowhere")
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr == "/nowhere: no such folder; check the path\n"


def test_the_position_of_the_camera_is_printed_at_every_frame(recording: Path) -> None:
    done = finished_fork("odometry.py", f"tum:{recording}")
    assert (done.stderr, done.returncode) == ("", 0)
    rows = [re.fullmatch(r"[\d.]+ \[(.*)\] ok", line) for line in done.stdout.splitlines()]
    assert len(rows) == FRAMES
    positions_m = [[float(x) for x in row[1].split()] for row in rows if row]
    assert positions_m[0] == [0.0, 0.0, 0.0]
    assert positions_m[-1] == pytest.approx([0.11, -0.044, 0.165], abs=0.01)  # as it was rendered


@pytest.mark.zenoh
def test_poses_of_the_map_epoch_are_printed_in_the_map() -> None:
    here = find_free_endpoint()
    with running_fake_service(here) as service:
        service.answers_map_odom(2.0, epoch=4)  # for a pose that overtakes it

        def tell() -> None:
            service.publish_map_odom(2.0, epoch=4)
            service.publish_pose(0, 1.0, epoch=3)
            service.publish_pose(1, 3.0, epoch=4)

        with program("pose_in_map.py", here) as lines:
            service.wait_for_reader()
            with again_and_again(tell):
                for _ in range(5):
                    x_m, y_m = lines.wait_for_line(rf"^12\.5 \[ *({NUMBER}) +({NUMBER}) ").groups()
                    assert (float(x_m), float(y_m)) == (3.0, 2.5)


@pytest.mark.zenoh
def test_a_service_without_a_map_is_reported(endpoint: str) -> None:
    done = finished_fork("pose_in_map.py", endpoint)
    assert (done.stderr, done.returncode) == ("there is no map yet\n", 1)


def test_poses_are_printed(endpoint: str) -> None:
    with program("print_poses.py", endpoint) as lines:
        lines.wait_for_line(rf"^{NUMBER} \[.*\] tracking$")
        lines.wait_for_line(rf"^{NUMBER} \[.*\] tracking$")


@pytest.mark.zenoh
def test_a_control_loop_runs_while_there_are_poses_and_stops_with_the_reason(endpoint: str) -> None:
    with PoseClient(connect=endpoint) as client, program("drive.py", endpoint) as lines:
        lines.wait_for_line(r"^drive: \d\.\d\d m to go$")
        client.send(PauseCommand())
        lines.wait_for_line("^stop: the service is paused$")
        client.send(ResumeCommand())
        lines.wait_for_line("^drive: ")


@pytest.mark.zenoh
def test_changes_of_the_status_are_printed(endpoint: str) -> None:
    with PoseClient(connect=endpoint) as client, program("watch_status.py", endpoint) as lines:
        lines.wait_for_line(r"^tracking: \d+ poses a second")
        client.send(PauseCommand())
        lines.wait_for_line("^lost: .*paused")
        client.send(ResumeCommand())
        lines.wait_for_line("^tracking: ")


@pytest.mark.zenoh
def test_a_reset_command_starts_a_new_epoch_at_the_given_pose(endpoint: str) -> None:
    with PoseClient(connect=endpoint) as client:
        poses = client.poses(timeout_s=100)
        before = next(poses)
        done = finished("send_command.py", endpoint)
        assert (done.stderr, done.returncode) == ("", 0)
        assert done.stdout == f"epoch {before.epoch + 1} begins at the charger\n"
        at_the_charger = next(pose for pose in poses if pose.epoch == before.epoch + 1)
    assert at_the_charger.position_m[0] == pytest.approx(2.0, abs=0.25)
    assert at_the_charger.quaternion_xyzw[2] == pytest.approx(0.707, abs=0.05)


@pytest.mark.zenoh
def test_a_simulated_base_sends_its_wheels() -> None:
    here = find_free_endpoint()
    received: list[WheelReading] = []
    with (
        running_fake_service(here) as service,
        program("simulated_base.py", "--slip", here) as base,
    ):
        service.session.declare_subscriber(
            "kinect/wheel_odom",
            lambda sample: received.append(parse_wheel_reading(sample.payload.to_bytes())),
        )
        base.wait_for_line(r"^\d+\.\d\d .* slip$")
        wait_until(lambda: len(received) >= 20)
    stamps_s = [reading.stamp_s for reading in received]
    assert stamps_s == sorted(stamps_s)
    assert received[-1].twist.forward_m_s == pytest.approx(0.2 * 1.02, rel=0.6)


def test_a_command_without_a_service_is_an_error() -> None:
    done = finished_fork("send_command.py", "tcp/127.0.0.1:1")
    assert "no kinect-vo answers" in done.stderr
    assert done.returncode == 1


def test_poses_are_written_to_csv(endpoint: str, tmp_path: Path) -> None:
    done = finished("poses_to_csv.py", tmp_path / "poses.csv", 2.0, endpoint)
    assert (done.stderr, done.returncode) == ("", 0)
    with (tmp_path / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 3
    stamps_s = [float(row["stamp_s"]) for row in rows]
    assert stamps_s == sorted(stamps_s)
    assert {row["state"] for row in rows} <= {"tracking", "degraded"}


def test_a_csv_program_without_a_file_prints_its_usage() -> None:
    done = finished_fork("poses_to_csv.py")
    assert "Usage: python poses_to_csv.py FILE.csv SECONDS" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 1


BEFORE_ENDPOINT = {
    "live_video.py": ("a.avi", "1"),
    "poses_to_csv.py": ("a.csv", "1"),
    "save_points.py": ("a.ply",),
    "web_page.py": ("8000",),
}


@pytest.mark.parametrize(
    "name", sorted(file.name for file in EXAMPLES.glob("*.py") if "[ENDPOINT" in file.read_text())
)
def test_a_wrong_endpoint_is_one_line(name: str) -> None:
    done = finished_fork(name, *BEFORE_ENDPOINT.get(name, ()), "nonsense")
    assert done.returncode == 1
    assert re.fullmatch(r".*[Ee]ndpoint.*nonsense.*\n|.*'nonsense': an endpoint.*\n", done.stderr)


def test_ctrl_c_ends_an_example_without_a_traceback() -> None:
    with program("print_poses.py", "tcp/127.0.0.1:1") as lines:
        lines.wait_for_line("waiting")
        lines.interrupt()
        assert lines.finish() == ("", 130)


@pytest.mark.zenoh
def test_live_video_has_an_image_for_each_frame(endpoint: str, tmp_path: Path) -> None:
    path = tmp_path / "video.avi"
    done = finished("live_video.py", path, 3, endpoint)
    assert (done.stderr, done.returncode) == ("", 0)
    video = cv2.VideoCapture(str(path))
    assert [video.read()[0] for _ in range(4)] == [True, True, True, False]


@pytest.mark.zenoh
def test_a_point_cloud_is_written(endpoint: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    done = finished("save_points.py", path, endpoint)
    assert (done.stderr, done.returncode) == ("", 0)
    count = int(done.stdout.split()[0])
    header, _, vertices = path.read_bytes().partition(b"end_header\n")
    assert f"element vertex {count}\n".encode() in header
    assert len(vertices) == 15 * count > 0


@pytest.mark.zenoh
def test_a_web_page_gets_video_and_positions(endpoint: str) -> None:
    port = free_port()
    with program("web_page.py", port, endpoint):

        def get(path: str) -> tuple[str, bytes]:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=100) as answer:
                return answer.headers["X-Pose"], answer.read()

        wait_until(lambda: is_listening(port))
        assert b"<canvas" in get("/")[1]
        for _ in range(2):
            position, image = get("/frame")
            assert len([float(number) for number in position.split()]) == 3
            assert image[:2] == b"\xff\xd8"


def fetch(url: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url, timeout=100) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


@pytest.mark.zenoh
def test_a_web_page_shows_why_there_is_no_frame_and_goes_on_when_there_is_one(
    endpoint: str,
) -> None:
    port = free_port()
    url = f"http://127.0.0.1:{port}/frame"
    with PoseClient(connect=endpoint) as client, program("web_page.py", port, endpoint):
        wait_until(lambda: is_listening(port))
        client.send(PauseCommand())
        wait_until(lambda: fetch(url)[0] == 503)
        code, reason = fetch(url)
        assert (code, reason[:22]) == (503, b"kinect: no frame withi")
        client.send(ResumeCommand())
        wait_until(lambda: fetch(url)[0] == 200)


@pytest.mark.zenoh
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs apt-get install chromium")
def test_a_browser_shows_video_and_trajectory(endpoint: str, tmp_path: Path) -> None:
    port, picture = free_port(), tmp_path / "page.png"
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,600"]
    options = [f"--user-data-dir={tmp_path}", "--virtual-time-budget=2000"]
    with program("web_page.py", port, endpoint):
        wait_until(lambda: is_listening(port))
        page = f"http://127.0.0.1:{port}/"
        command = [*browser, *options, f"--screenshot={picture}", page]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL, timeout=100)
    image = cv2.imread(str(picture))
    assert image is not None
    video, canvas = image[250:480, 8:320], image[8:480, 340:800]
    assert len(np.unique(video.reshape(-1, 3), axis=0)) > 100
    assert np.count_nonzero(canvas.max(axis=2) < 50) >= 4  # a dot for each pose


def is_listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_plain_zenoh_reads_the_same(endpoint: str) -> None:
    with program("plain_zenoh.py", endpoint) as lines:
        lines.wait_for_line("^status: tracking$")
        lines.wait_for_line(r"^\d+\.\d{9} odom->base_link at \(")
        lines.wait_for_line("'state': 'tracking'")


@pytest.mark.zenoh
def test_plain_zenoh_says_that_there_is_no_service() -> None:
    endpoint = find_free_endpoint()
    with program("plain_zenoh.py", endpoint) as lines:
        lines.wait_for_line(f"^no service at {endpoint}; waiting for one$")


def complaint_when_the_reader_leaves(name: str, argument: str) -> str:
    """What an example writes to stderr in `EXAMPLE ARGUMENT | head -1`."""
    command = [sys.executable, str(EXAMPLES / name), argument]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True) as process:  # type: ignore[call-overload]
        limit = threading.Timer(100.0, process.kill)
        limit.start()
        assert process.stdout.readline()
        process.stdout.close()
        complaint: str = process.stderr.read()
    limit.cancel()
    assert process.returncode in (0, -signal.SIGPIPE)
    return complaint


@pytest.mark.zenoh
@pytest.mark.parametrize("name", ["plain_zenoh.py", "print_poses.py", "drive.py"])
def test_an_example_ends_without_an_error_when_its_reader_leaves(endpoint: str, name: str) -> None:
    assert complaint_when_the_reader_leaves(name, endpoint) == ""


@pytest.mark.parametrize("name", ["odometry.py", "read_camera.py"])
def test_an_example_of_a_camera_ends_without_an_error_when_its_reader_leaves(
    long_recording: Path, name: str
) -> None:
    assert complaint_when_the_reader_leaves(name, f"tum:{long_recording}") == ""


@pytest.mark.zenoh
@pytest.mark.parametrize(("name", "arguments"), [("live_video.py", [3]), ("save_points.py", [])])
def test_a_program_that_gets_no_frame_is_one_line(
    tmp_path: Path, name: str, arguments: list[int]
) -> None:
    done = finished_fork(name, tmp_path / "out", *arguments, find_free_endpoint())
    assert "no kinect-vo publishes there" in done.stderr.splitlines()[-1]
    assert ("Traceback" in done.stderr, done.returncode) == (False, 1)


def test_commands_and_their_errors_work_from_the_shell(endpoint: str) -> None:
    done = kinect_vo("command", "pause", "--connect", endpoint)
    assert (json.loads(done.stdout), done.returncode) == ({"paused": True}, 0)
    assert kinect_vo("command", "resume", "--connect", endpoint).returncode == 0
    wrong = kinect_vo("command", "tilt", "tilt_deg=high", "--connect", endpoint)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "give a number, at least -31 and at most 31 (degrees above the horizon)" in wrong.stderr
    refused = kinect_vo("command", "tilt", "tilt_deg=3", "--connect", endpoint)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert "(not-possible)" in refused.stderr


@pytest.mark.zenoh
def test_all_messages_of_a_running_service_match_its_schemas(endpoint: str) -> None:
    with PoseClient(connect=endpoint) as client:
        schemas = client.schemas()
        assert schema_errors(schemas["status"], dict(client.status())) == []
        for key, name in (("kinect/latest", "odom-attachment"), ("kinect/status", "status")):
            check_reply(client, key, schemas[name])
        for command in ("reset", "pause", "resume", "save-incident"):
            check_reply(client, f"kinect/command/{command}", schemas[f"{command}-answer"])
        check_reply(client, "kinect/command/dance", schemas["error"])


def check_reply(client: PoseClient, key: str, schema: dict[str, Any]) -> None:
    """The JSON of a reply (of a pose, its attachment) is valid and has no key of its own."""
    (reply,) = client._connection.sessions[0].get(key, timeout=100)
    if reply.ok is None:
        assert reply.err is not None
        payload = reply.err.payload
    else:
        payload = reply.ok.attachment or reply.ok.payload
    content = json.loads(payload.to_bytes())
    assert schema_errors(schema, content) == [], content
    assert content.keys() <= schema["properties"].keys()


def documented_programs(page: str) -> list[str]:
    text = (EXAMPLES.parent / page).read_text()
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def test_camera_programs_in_the_documentation_run(recording: Path) -> None:
    programs = [
        code for code in documented_programs("docs/guide/python.md") if "open_camera" in code
    ]
    assert len(programs) == 2
    for code in programs:
        here = code.replace("recordings/desk", str(recording))
        done = forked_process.run([sys.executable, "-c", here])
        assert (done.stderr, done.stdout.count("\n")) == ("", FRAMES)


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "docs/reference/messages.md",
        "docs/guide/first-run.md",
        "docs/guide/frames.md",
        "docs/guide/python.md",
    ],
)
def test_service_programs_in_the_documentation_run(endpoint: str, page: str) -> None:
    programs = [code for code in documented_programs(page) if "open_camera" not in code]
    assert programs
    for code in programs:
        # Elsewhere than the service of somebody who works on this computer, and not for so long.
        here = code.replace("tcp/127.0.0.1:7450", endpoint).replace("sleep(10)", "sleep(1)")
        here = re.sub(r"(PoseClient|FrameClient)\(\)", rf"\1(connect={endpoint!r})", here)
        unbuffered = f"import sys\nsys.stdout.reconfigure(line_buffering=True)\n{here}"
        with output_of([sys.executable, "-c", unbuffered], ForkedProcess) as lines:
            lines.wait_for_line("tracking|degraded|240, 320, 3")
