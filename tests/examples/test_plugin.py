"""The example of a plug-in, installed as a user would, and plug-ins that fail."""

import subprocess
import sys
from pathlib import Path

import pytest

from drivers.camera import PlaybackMode
from drivers.core import InputError
from drivers.registry import CAMERAS, open_camera
from tests.simulators.requirements import skip_or_fail
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.outputs.recorder.recorder_inputs import make_update
from vo_service.app import OutputsConfig, open_outputs, run_replay
from vo_service.config import read_config
from vo_service.frame_source import FrameSource
from vo_service.signals import stop_on_signals

ROOT = Path(__file__).parents[2]
UV = ROOT / ".tools" / "bin" / "uv"
NAMES = ("kinect_vo_example", "kinect_vo_example.camera", "kinect_vo_example.output")
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package of examples/plugin, installed without a network."""
    if not UV.exists():
        skip_or_fail(f"needs {UV}: run scripts/setup.sh")
    folder = tmp_path_factory.mktemp("site-packages")
    source = ROOT / "examples" / "plugin"
    options = ("--offline", "--no-deps", "--quiet", "--python", sys.executable)
    subprocess.run(
        [UV, "pip", "install", *options, "--target", folder, source], check=True, timeout=100
    )
    return folder


@pytest.fixture
def plugin(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The installed package is on the path."""
    monkeypatch.syspath_prepend(str(installed))
    for name in NAMES:
        monkeypatch.delitem(sys.modules, name, raising=False)


def register(folder: Path, monkeypatch: pytest.MonkeyPatch, entry_points: str) -> None:
    """Put a package on the path that has only these entry points."""
    info = folder / "broken-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1\n")
    (info / "entry_points.txt").write_text(entry_points)
    monkeypatch.syspath_prepend(str(folder))


def test_the_example_is_short() -> None:
    for name in ("camera.py", "output.py"):
        text = (ROOT / "examples/plugin/kinect_vo_example" / name).read_text()
        assert len(text.splitlines()) < 60


@pytest.mark.slow
@pytest.mark.usefixtures("plugin")
def test_the_service_uses_the_camera_and_the_output_of_a_plugin(
    tmp_path: Path, capfd: Capture
) -> None:
    file = tmp_path / "config.toml"
    file.write_text(
        'schema = 1\n[camera]\nsource = "wall:8"\n[odometry]\nmethod = "surf"\n'
        f'[outputs]\nextra = ["distance:{tmp_path}/way.txt"]\n'
    )
    assert run_in_process(capfd, "config", "check", str(file)).code == 0
    config = read_config(file)
    request = OutputsConfig(PlaybackMode.LOCKSTEP, zenoh=None, extra=config.outputs.extra)
    with (
        open_camera(config.camera.source, playback_mode=PlaybackMode.LOCKSTEP) as camera,
        open_outputs(request) as opened,
        stop_on_signals() as stop,
    ):
        run_replay(config, camera, FrameSource(camera), opened.outputs, stop)
    assert float((tmp_path / "way.txt").read_text().split()[0]) == pytest.approx(0.07, abs=0.01)


@pytest.mark.usefixtures("plugin")
def test_names_are_known_without_an_import(tmp_path: Path, capfd: Capture) -> None:
    assert CAMERAS.plugins == ("wall",)
    assert "--camera wall[:ARGUMENT]  plug-in" in run_in_process(capfd, "devices").out
    with pytest.raises(InputError, match=r"synthetic, wall\[:ARGUMENT\]"):
        open_camera("kinekt")
    (tmp_path / "c.toml").write_text('schema = 1\n[outputs]\nextra = ["way:x"]\n')
    with pytest.raises(InputError, match="'way:x' is unknown; known here: trajectory, distance"):
        read_config(tmp_path / "c.toml")
    assert not set(NAMES) & set(sys.modules)


def test_a_camera_that_cannot_be_imported_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Capture
) -> None:
    register(tmp_path, monkeypatch, "[kinect_vo.cameras]\nbad = no_such_module:Camera\n")
    outcome = run_in_process(capfd, "run", "--camera", "bad", "--no-publish")
    assert outcome.code == 2
    (line,) = outcome.err.splitlines()
    assert "camera 'bad' of the package broken cannot be imported (ModuleNotFoundError" in line


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("no_such_module:Output", "cannot be imported (ModuleNotFoundError"),
        ("builtins:int", "switched off: TypeError"),
        ("types:SimpleNamespace", "switched off: TypeError"),
    ],
)
def test_an_output_that_fails_is_switched_off(
    target: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    register(tmp_path, monkeypatch, f"[kinect_vo.outputs]\nbad = {target}\n")
    request = OutputsConfig(PlaybackMode.REALTIME, zenoh=None, extra=("bad:7",))
    with open_outputs(request) as opened:
        for _ in range(2):
            opened.outputs[0].on_update(make_update(0))
        assert words in opened.outputs[0].warning
    assert len([record for record in caplog.records if words in record.message]) == 1
