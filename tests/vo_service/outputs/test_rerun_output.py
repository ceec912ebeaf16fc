"""Real Rerun recordings, read back, and real viewers that do not take their data."""

import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from drivers.errors import InputError
from drivers.geometry import rigid_transform, transform_points
from drivers.trajectory import StampedPoses
from vo_service.outputs.output import PoseUpdate, Status
from vo_service.outputs.rerun_output import RerunOutput, Throttle, open_rerun
from vo_service.outputs.rerun_scene import back_project
from vo_service.outputs.rerun_sinks import RecordingFile

MakeUpdate = Callable[..., PoseUpdate]
RERUN = Path(str(find_spec("rerun_cli").origin)).with_name("rerun")  # type: ignore[union-attr]


def record(path: Path, updates: list[PoseUpdate], truth: StampedPoses | None = None) -> None:
    sink = RecordingFile(path)
    sink.queue = len(updates)  # nothing dropped, however slow the day
    output = RerunOutput(sink, lambda: truth)
    for update in updates:
        output.pose(update)
    output.close()
    assert (output.dropped, output.errors) == (0, 0)


def rows(path: Path) -> Counter[str]:
    """How often each entity was logged."""
    counter: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        counter[chunk.entity_path] += chunk.num_rows
    return counter


def column(path: Path, entity: str, component: str) -> list[object]:
    """Everything logged as one component of an entity."""
    batches = [c.to_record_batch() for c in RrdReader(path).stream() if c.entity_path == entity]
    with_it = [batch for batch in batches if component in batch.schema.names]
    return [value for batch in with_it for value in batch.column(component).to_pylist()]


def test_a_recording_is_whole_and_holds_everything(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    record(path, [make_update(seq) for seq in range(30)])
    done = subprocess.run([RERUN, "rrd", "verify", path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    counted = rows(path)
    assert counted["/world/camera"] == 30
    assert counted["/plots/stages/surf"] == 30
    for entity in ("image", "image/features", "image/inliers", "image/outliers", "points"):
        assert counted[f"/world/camera/{entity}"] == 10  # pictures: ten a second of thirty
    assert counted["/depth"] == counted["/world/trajectory/00000"] == 10


def test_poses_and_counts_come_back_as_they_went_in(
    tmp_path: Path, make_update: MakeUpdate
) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq) for seq in range(5)]
    record(path, updates)
    positions = column(path, "/world/camera", "Transform3D:translation")
    expected = [[u.T_world_camera[:3, 3].tolist()] for u in updates]
    np.testing.assert_allclose(np.array(positions), np.array(expected), atol=1e-6)
    assert column(path, "/plots/counts/inliers", "Scalars:scalars") == [[7.0]] * 5


def test_a_long_trajectory_grows_in_segments(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    record(path, [make_update(seq) for seq in range(0, 3 * 300, 3)])
    counted = rows(path)
    segments = [counted[f"/world/trajectory/{number:05d}"] for number in range(4)]
    assert segments == [128, 127, 45, 0]


def test_truth_starts_where_the_estimate_does(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq) for seq in range(10)]
    T_truth_world = rigid_transform(np.diag([-1.0, -1.0, 1.0]), [5.0, 6.0, 7.0])
    stamps = np.array([update.stamp_s for update in updates])
    poses = np.array([T_truth_world @ update.T_world_camera for update in updates])
    record(path, updates, StampedPoses(stamps, poses))
    (strips,) = column(path, "/world/ground_truth", "LineStrips3D:strips")
    expected = [update.T_world_camera[:3, 3] for update in updates]
    np.testing.assert_allclose(np.array(strips)[0], expected, atol=1e-5)


def test_truth_of_another_time_is_not_drawn(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    truth = StampedPoses(np.array([1.0, 2.0]), np.array([np.eye(4), np.eye(4)]))
    record(path, [make_update(0)], truth)
    assert rows(path)["/world/ground_truth"] == 0


def test_only_changes_of_state_are_written_down(
    tmp_path: Path, make_update: MakeUpdate, status: Status
) -> None:
    path = tmp_path / "out.rrd"
    output = RerunOutput(RecordingFile(path))
    for seq, ok in enumerate([True, True, False, False]):
        output.pose(make_update(seq, ok=ok))
    output.status(status)
    output.status(status)
    output.close()
    assert column(path, "/log", "TextLog:text") == [
        ["tracking (epoch 1)"],
        ["lost: too few matches (epoch 1)"],
        ["degraded: few inliers (epoch 1)"],
    ]


def test_points_fall_back_onto_their_pixels(make_update: MakeUpdate) -> None:
    frame = make_update(0).frame
    points, colours = back_project(frame, grid_px=4)
    pixels = transform_points(rigid_transform(frame.camera.K, np.zeros(3)), points.astype(float))
    pixels = (pixels / pixels[:, 2:])[:, :2]
    np.testing.assert_allclose(pixels, np.round(pixels / 4) * 4, atol=1e-3)
    assert len(points) == 16 * 12 - 4  # the hole in the depth covers four grid points
    assert np.all(points[:, 2] > 0)
    assert len(colours) == len(points)


def test_pictures_come_at_most_once_a_period_and_again_after_a_clock_step() -> None:
    throttle = Throttle(0.1)
    stamps_s = [0.0, 0.033, 0.066, 0.0999, 0.12, -50.0, -49.99, -49.8]
    assert [throttle.due(stamp_s) for stamp_s in stamps_s] == [
        True, False, False, True, False, True, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    "target",
    [
        "missing/out.rrd", "not\udcffutf8/out.rrd", "connect:no port", "connect:robot:0",
        "connect:robot:65536", "serve?", "out.txt",
    ],
)  # fmt: skip
def test_a_bad_target_is_one_line(tmp_path: Path, target: str) -> None:
    name = str(tmp_path / target) if "/" in target else target
    with pytest.raises(InputError) as caught:
        open_rerun(name)
    assert "\n" not in str(caught.value)


def test_without_rerun_it_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("vo_service.outputs.rerun_output.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'kinect-vo\[rerun\]'"):
        open_rerun(str(tmp_path / "out.rrd"))


FLOOD = """
import dataclasses, sys, time
import numpy as np
from conftest import _update
from vo_service.outputs.rerun_output import RerunOutput
from vo_service.outputs.rerun_sinks import Viewer
update = _update(0)
noise = np.random.default_rng(0).integers(0, 255, (960, 1280, 3), np.uint8)
update = dataclasses.replace(update, frame=dataclasses.replace(update.frame, colour_bgr=noise))
address = f"rerun+http://127.0.0.1:{sys.argv[1]}/proxy"
output = RerunOutput(Viewer(address), picture_period_s=0.0)
output.pose(update)
print("ready", flush=True)
sys.stdin.readline()
longest_s = 0.0
for _ in range(300):
    start_s = time.monotonic()
    output.pose(update)
    longest_s = max(longest_s, time.monotonic() - start_s)
    time.sleep(0.01)
output.close()
print(longest_s, output.dropped)
"""


def flood(port: int, freeze: Callable[[], None]) -> subprocess.CompletedProcess[str]:
    """Log more than any buffer takes, close, leave; `freeze` is called when it is connected."""
    with subprocess.Popen(
        [sys.executable, "-c", FLOOD, str(port)],
        cwd=Path(__file__).parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        freeze()
        output, errors = process.communicate("go\n", timeout=30)
    return subprocess.CompletedProcess(process.args, process.returncode, output, errors)


def assert_nothing_was_held_up(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 0
    longest_s, dropped = done.stdout.split()
    assert float(longest_s) < 1.0
    assert int(dropped) > 100
    assert "does not take its data" in done.stderr


def test_a_viewer_that_never_comes_holds_nothing_up(free_port: int) -> None:
    done = flood(free_port, lambda: None)
    assert_nothing_was_held_up(done)
    assert "no Rerun viewer at" in done.stderr


def test_a_frozen_viewer_holds_nothing_up(free_port: int) -> None:
    command = [str(RERUN), "--serve-grpc", "--bind", "127.0.0.1", "--port", str(free_port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as viewer:
        try:
            wait_until_open(free_port)
            done = flood(free_port, lambda: viewer.send_signal(signal.SIGSTOP))
        finally:
            viewer.kill()
    assert_nothing_was_held_up(done)


def wait_until_open(port: int) -> None:
    for _ in range(200):
        with suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.05)
    raise AssertionError(f"nothing listens on {port}")
