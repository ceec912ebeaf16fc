"""Commands that compute nothing start without what only computing needs."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.subprocess

EXAMPLE = Path(__file__).parents[2] / "config" / "kinect.toml"
HEAVY = ("numba", "matplotlib", "rerun", "scipy")
PROGRAM = f"""
import sys
from vo_service.cli import main
try:
    main()
except SystemExit as end:
    print([name for name in {HEAVY} if name in sys.modules], end.code)
"""


@pytest.mark.parametrize(
    "arguments", [("--help",), ("config", "check", str(EXAMPLE)), ("run", "--help")]
)
def test_a_command_that_computes_nothing_loads_no_heavy_library(arguments: tuple[str, ...]) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, check=True
    )
    assert ended.stdout.splitlines()[-1] == "[] 0"


@pytest.mark.parametrize(
    "worker", ["vo_service.outputs.recorder.worker", "vo_service.outputs.rerun.worker"]
)
def test_a_worker_process_without_kernels_does_not_load_numba(worker: str) -> None:
    program = f"import sys, {worker}; print('numba' in sys.modules)"
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ended.stdout == "False\n"


INTERRUPTED_EARLY = """
import sys
known = set(sys.modules)
from vo_service.cli import main
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
    assert "vo_service.cli" in ended.stdout
    assert not {"argparse", "logging", "numpy"} & set(ended.stdout.split("'"))
