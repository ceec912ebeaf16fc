"""What `uv build` makes: valid metadata, and a wheel that works in an empty virtual environment."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = ROOT / ".tools" / "bin" / "uv"
PROGRAM = """
from importlib.metadata import version
import drivers, vo_service
assert "site-packages" in vo_service.__file__, vo_service.__file__
print(version("kinect-vo"))
"""
SHARED_FILES = (
    "share/man/man1/kinect-vo.1",
    "share/bash-completion/completions/kinect-vo",
    "share/zsh/site-functions/_kinect-vo",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.subprocess,
    pytest.mark.skipif(not UV.exists(), reason="needs uv of scripts/setup.sh in .tools/"),
]


def run(*command: object, cwd: Path = ROOT, environment: Path | None = None) -> str:
    words = [str(word) for word in command]
    variables = os.environ | {"UV_PROJECT_ENVIRONMENT": str(environment or ROOT / ".venv")}
    done = subprocess.run(words, cwd=cwd, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution, built without a network."""
    folder = tmp_path_factory.mktemp("dist")
    run(UV, "build", "--offline", "--quiet", "--python", sys.executable, "--out-dir", folder)
    return folder


def test_the_metadata_is_valid(built: Path) -> None:
    names = sorted(built.glob("kinect_vo-*"))
    assert len(names) == 2
    run(sys.executable, "-m", "twine", "check", "--strict", *names)


def test_the_wheel_works_in_an_empty_environment(built: Path, tmp_path: Path) -> None:
    """The other packages come from the cache of uv, into which `scripts/setup.sh` has put them."""
    (wheel,) = built.glob("*.whl")
    environment = tmp_path / "env"
    run(UV, "sync", "--offline", "--quiet", "--frozen", "--no-dev", "--no-install-project",
        "--python", sys.executable, environment=environment)  # fmt: skip
    run(UV, "pip", "install", "--offline", "--quiet", "--no-deps",
        "--python", environment / "bin" / "python", wheel)  # fmt: skip
    version = wheel.name.split("-")[1]
    assert run(environment / "bin" / "python", "-c", PROGRAM, cwd=tmp_path) == f"{version}\n"
    assert run(environment / "bin" / "kinect-vo", "--version", cwd=tmp_path).endswith(
        f"{version}\n"
    )
    assert all((environment / file).is_file() for file in SHARED_FILES)
