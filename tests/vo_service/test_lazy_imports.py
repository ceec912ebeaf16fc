"""Commands that compute nothing start without what only computing needs."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.ports import free_port
from tests.vo_service.corner_sequence import corner_frames

pytestmark = pytest.mark.subprocess

EXAMPLE = Path(__file__).parents[2] / "config" / "kinect.toml"
HEAVY = ("numba", "matplotlib", "rerun", "scipy")
PROGRAM = f"""
import os, sys
from vo_service.__main__ import main
try:
    main()
except SystemExit as end:
    assert "MALLOC_ARENA_MAX" not in os.environ  # limits of memory cost other commands time
    print([name for name in {HEAVY} if name in sys.modules], end.code)
"""


@pytest.mark.parametrize(
    "arguments", [("--help",), ("config", "check", str(EXAMPLE)), ("run", "--help")]
)
def test_a_command_that_computes_nothing_loads_no_heavy_library(arguments: tuple[str, ...]) -> None:
    # A service that another test runs in this process sets them.
    environment = {key: os.environ[key] for key in os.environ if not key.startswith("MALLOC_")}
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments],
        capture_output=True, text=True, check=True, env=environment,
    )  # fmt: skip
    assert ended.stdout.splitlines()[-1] == "[] 0"


def test_the_mapper_loads_no_sparse_solver_before_the_first_loop() -> None:
    program = "import sys, vo_service.mapper_process; print('scipy.sparse' in sys.modules)"
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ended.stdout == "False\n"


INTERRUPTED_EARLY = """
import sys
known = set(sys.modules)
from vo_service.__main__ import main
print(sorted(set(sys.modules) - known))

class CtrlC:
    def find_spec(self, name, path, target=None):
        raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
main()
"""


def test_ctrl_c_while_loading_ends_quietly() -> None:
    program = [sys.executable, "-c", INTERRUPTED_EARLY, "--help"]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (130, "")
    assert "vo_service" in ended.stdout
    assert not {"argparse", "logging", "numpy"} & set(ended.stdout.split("'"))


# The service on a recording, with all outputs that are on by default.
RUN_UNTIL_THE_END = """
import logging, os, signal, sys
from vo_service.__main__ import main

class StopAtTheEnd(logging.Handler):
    def emit(self, record):
        if "the recording has ended" in record.getMessage():
            os.kill(os.getpid(), signal.SIGTERM)

logging.getLogger().addHandler(StopAtTheEnd())
try:
    main()
except SystemExit as end:
    assert end.code == 0
assert "scipy.linalg" not in sys.modules  # it takes 13 MB
assert "MALLOC_ARENA_MAX" in os.environ  # a service returns the memory of its images
print([name for name in sys.modules if name.partition(".")[0] in ("drivers", "vo_service")])
"""


@pytest.mark.slow
@pytest.mark.zenoh
def test_a_run_imports_only_the_files_that_it_uses(tmp_path: Path) -> None:
    with FrameRecorder(TumFolder(tmp_path / "recording")) as writer:
        for frame in corner_frames(3):
            writer.write(frame)
    config = tmp_path / "kinect.toml"
    # Without loop closure, so that its kernels are not compiled here; it imports one file more.
    config.write_text(
        f'schema = 1\n[zenoh]\nlisten = ["tcp/127.0.0.1:{free_port()}"]\n'
        "[map]\nloop_closure = false\n"
    )
    options = ("run", "--config", str(config), "--camera", f"tum:{tmp_path / 'recording'}")
    ended = subprocess.run(
        [sys.executable, "-c", RUN_UNTIL_THE_END, *options],
        capture_output=True, text=True, check=True,
        env={**os.environ, "STATE_DIRECTORY": str(tmp_path)},
    )  # fmt: skip
    imported = ast.literal_eval(ended.stdout)
    assert "vo_service.outputs.zenoh.output" in imported
    assert not {name for name in imported if "rerun" in name or ".tools" in name}
