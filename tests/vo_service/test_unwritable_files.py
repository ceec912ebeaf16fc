"""Every writer on a full disk, in a read-only folder, and in one that is removed meanwhile.

Each says in one line which file cannot be written and why, and leaves nothing half-written.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path

import pytest

from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import PlaybackMode
from drivers.core import UserFacingError, write_errors
from drivers.core.write_errors import WriteError
from drivers.playback.recording_formats import open_recording
from drivers.recording import frame_recorder
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.full_disk import limit_file_size
from tests.read_only_folder import read_only
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.outputs.recorder.recorder_inputs import make_frame, make_update
from tests.vo_service.outputs.rerun.rerun_recording import make_config
from vo_service.outputs.mcap_recording import open_mcap_recording
from vo_service.outputs.recorder.incidents import IncidentStore
from vo_service.outputs.rerun import rotating_recording
from vo_service.outputs.rerun.rotating_recording import RotatingRecording
from vo_service.outputs.rerun.sinks import RrdFileSink
from vo_service.outputs.trajectory.trajectory_file import open_trajectory
from vo_service.sensor_memory import RememberedSensor, write_remembered_sensor
from vo_service.slam.mapper.map_store import MapStore
from vo_service.tools.calibration.output_files import save_with_backup
from vo_service.tools.certificates import CertificateAuthority
from vo_service.tools.convert import OutputFormat, convert
from vo_service.tools.doctor.report import open_bug_report
from vo_service.tools.download.transfer import PartialFile

# Calls its second argument when a part is written, and writes the rest to its first.
Writer = Callable[[Path, Callable[[], None]], None]
DATA = 10_000 * b"x"


def record_mcap(path: Path, midway: Callable[[], None]) -> None:
    with FrameRecorder(McapRecordingFile(path)) as recorder:
        recorder.write(make_frame(0))
        midway()
        for seq in range(1, 20):
            recorder.write(make_frame(seq))


def record_folder(path: Path, midway: Callable[[], None]) -> None:
    with FrameRecorder(TumFolder(path)) as writer:
        midway()
        for seq in range(20):
            writer.write(make_frame(seq))


def output_mcap(path: Path, midway: Callable[[], None]) -> None:
    with closing(open_mcap_recording(path, PlaybackMode.LOCKSTEP)) as output:
        midway()
        for seq in range(20):
            output.on_update(make_update(seq))


def output_trajectory(path: Path, midway: Callable[[], None]) -> None:
    with closing(open_trajectory(str(path), PlaybackMode.LOCKSTEP)) as output:
        midway()
        for seq in range(100):
            output.on_update(make_update(seq))


def output_rrd(path: Path, midway: Callable[[], None]) -> None:
    recording = RotatingRecording(make_config(RrdFileSink(path)))
    midway()
    recording.check()
    fault = recording.fault
    recording.finish()
    if fault:
        raise UserFacingError(fault)


def save_incident(path: Path, midway: Callable[[], None]) -> None:
    def write_content(folder: Path) -> None:
        record_folder(folder, midway)

    IncidentStore(path, 10**9).write("2026-01-01T00-00-00Z-lost", write_content)


def save_map(path: Path, midway: Callable[[], None]) -> None:
    def write_content(file: Path) -> None:
        midway()
        file.write_bytes(DATA)

    MapStore(path.parent).write(path, 10**9, write_content)


def save_sensor(path: Path, midway: Callable[[], None]) -> None:
    midway()
    write_remembered_sensor(path.parent, RememberedSensor("A", 0.02, 0.001, 0.002, 0.003))


def save_camera_file(path: Path, midway: Callable[[], None]) -> None:
    midway()
    save_with_backup(path, DATA)


def save_report(path: Path, midway: Callable[[], None]) -> None:
    with open_bug_report(path) as folder:
        (folder / "a.txt").write_text("a")
        midway()
        (folder / "b.txt").write_text("b" * 10_000)


def make_certificates(path: Path, midway: Callable[[], None]) -> None:
    midway()
    CertificateAuthority(path).issue_client_certificate("reader", 30)


def download(path: Path, midway: Callable[[], None]) -> None:
    with PartialFile(path / ".a.tgz.part") as part:
        part.restart("http://127.0.0.1/a.tgz", "")
        midway()
        part.append(DATA)


def convert_to(
    output_format: OutputFormat, recording: Path, path: Path, midway: Callable[[], None]
) -> None:
    def progress(written: int) -> None:
        if written == 1:
            midway()

    convert(open_recording(recording), path, output_format, progress)


WRITERS: dict[str, tuple[str, Writer]] = {
    "record FILE.mcap": ("out/a.mcap", record_mcap),
    "record FOLDER": ("out/a", record_folder),
    "--mcap": ("out/a.mcap", output_mcap),
    "--trajectory": ("out/a.txt", output_trajectory),
    "--rerun FILE.rrd": ("out/a.rrd", output_rrd),
    "incident": ("out/incidents", save_incident),
    "map": ("out/a.map", save_map),
    "memory of a sensor": ("out/A.toml", save_sensor),
    "camera file": ("out/camera.toml", save_camera_file),
    "doctor --report": ("out/a.tar.gz", save_report),
    "certificates": ("out/keys", make_certificates),
    "download": ("out", download),
}
CONVERTED = {
    OutputFormat.FOLDER: "out/a",
    OutputFormat.MCAP: "out/a.mcap",
    OutputFormat.ROS1: "out/a.bag",
    OutputFormat.ROS2: "out/a",
}


@contextmanager
def full(limit_bytes: int, folder: Path) -> Iterator[None]:
    """A disk that takes no more than this for each file, and has nothing free."""
    with pytest.MonkeyPatch.context() as patch, limit_file_size(limit_bytes):
        patch.setattr(write_errors, "free_disk_bytes", lambda _: 0)
        yield


@contextmanager
def removed(folder: Path) -> Iterator[None]:
    shutil.rmtree(folder)
    yield


Situation = Callable[[Path], AbstractContextManager[None]]
FROM_THE_START: dict[str, Situation] = {"full": partial(full, 0), "read-only": read_only}
MIDWAY: dict[str, Situation] = {"full": partial(full, 100), "removed": removed}
# Two create their folder anew. Rerun hangs at a file that cannot grow: see `test_rrd_file_sink`.
NOT_APPLICABLE = {
    ("memory of a sensor", "removed"),
    ("certificates", "removed"),
    ("--rerun FILE.rrd", "full"),
}
CAUSES = {
    "full": ("the disk is full", "stops after"),
    "read-only": ("Permission denied",),
    "removed": ("there is no folder", "No such file", "it was removed"),
}


@pytest.fixture(autouse=True)
def checked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_recorder, "FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr(rotating_recording, "CHECK_PERIOD_S", 0.0)


@pytest.fixture
def writer(request: pytest.FixtureRequest, recording: Path, tmp_path: Path) -> tuple[Path, Writer]:
    """A writer and its file."""
    (tmp_path / "out").mkdir()
    if isinstance(request.param, OutputFormat):
        path = tmp_path / CONVERTED[request.param]
        return path, partial(convert_to, request.param, recording)
    name, write = WRITERS[request.param]
    return tmp_path / name, write


def assert_reported(error: UserFacingError, situation: str, path: Path) -> None:
    """One line names the file, or one below the folder, and the cause; nothing partial is left."""
    cause = error if isinstance(error, WriteError) else error.__cause__
    text = str(cause if isinstance(cause, UserFacingError) else error)
    file = Path(text.partition(": ")[0])
    assert path in (file, *file.parents), text
    assert any(each in text for each in CAUSES[situation]), text
    assert "\n" not in text
    assert error.exit_code == 1
    left = [file for file in path.parent.rglob("*") if file.is_file()]
    assert [file for file in left if not file.stat().st_size or is_partial(file)] == []


def is_partial(file: Path) -> bool:
    return ".part" in str(file) and not file.name.startswith(".a.tgz")  # a download is resumed


@pytest.mark.parametrize("situation", FROM_THE_START)
@pytest.mark.parametrize("writer", [*WRITERS, *CONVERTED], indirect=True)
def test_a_folder_that_takes_nothing_is_one_line_and_stays_empty(
    writer: tuple[Path, Writer], situation: str, tmp_path: Path
) -> None:
    path, write = writer
    with FROM_THE_START[situation](tmp_path / "out"), pytest.raises(UserFacingError) as caught:
        write(path, lambda: None)
    assert_reported(caught.value, situation, path)
    assert [file for file in (tmp_path / "out").rglob("*") if file.is_file()] == []


@pytest.mark.parametrize(
    ("writer", "situation"),
    [
        (each, situation)
        for each in (*WRITERS, *CONVERTED)
        for situation in MIDWAY
        if (each, situation) not in NOT_APPLICABLE
    ],
    indirect=["writer"],
)
def test_a_folder_that_fails_midway_is_one_line_and_holds_nothing_partial(
    writer: tuple[Path, Writer], situation: str, tmp_path: Path
) -> None:
    path, write = writer
    with ExitStack() as stack, pytest.raises(UserFacingError) as caught:
        write(path, lambda: stack.enter_context(MIDWAY[situation](tmp_path / "out")))
    assert_reported(caught.value, situation, path)


COMMANDS = {
    "record": "record --camera tum:{recording} {out}/a",
    "record FILE.mcap": "record --camera tum:{recording} {out}/a.mcap",
    "replay --trajectory": "replay {recording} --no-publish --trajectory {out}/a.txt",
    "replay --optimized-trajectory": "replay {recording} --optimized-trajectory {out}/a.txt",
    "replay --mcap": "replay {recording} --no-publish --mcap {out}/a.mcap",
    "run --mcap": "run --camera tum:{recording} --no-publish --mcap {out}/a.mcap",
    "convert": "convert {recording} {out}/a.mcap",
    "evaluate --picture": "evaluate {recording}/groundtruth.txt {recording} --picture {out}/a.png",
    "reconstruct": "reconstruct {recording} --output {out}",
    "demo": "demo --output {out}",
    "compare": "compare {recording} --output {out}",
    "certificates": "certificates {out}/keys --reader reader",
    "calibrate --print-board": "calibrate --square 0.03 --print-board {out}/a.pdf",
    "download": "download freiburg1_xyz --output {out}",
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_on_a_read_only_folder_is_one_line(
    command: str, recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with read_only(out):
        words = COMMANDS[command].format(recording=recording, out=out).split()
        outcome = run_in_process(capfd, *words)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.error_lines.startswith(f"kinect-vo: error: {out}")
    assert "Permission denied" in outcome.error_lines
    assert outcome.error_lines.count("\n") == 1
    assert list(out.iterdir()) == []
