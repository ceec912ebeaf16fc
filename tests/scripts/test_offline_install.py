"""Making a folder of wheels, and installing from one: what is asked for, and what is refused.

The whole way, with every wheel and no network, is `scripts/test_offline.sh`.
"""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.simulators.requirements import skip_or_fail

pytestmark = pytest.mark.subprocess

SCRIPTS = Path(__file__).parents[2] / "scripts"
MACHINE = platform.machine()
# Not the environment that the tests run in, but what it was made with.
PYTHON = str(Path(sys.base_prefix) / "bin" / f"python3.{sys.version_info.minor}")


def run(*command: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [str(part) for part in command],
        env=os.environ | {"KINECT_VO_PYTHON": PYTHON},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ([], "name the folder to make"),
        (["--fast", "wheels"], "--fast is unknown"),
        (["--machine", "riscv64", "wheels"], "no wheels for the machine riscv64"),
        (["--python", "3.10", "wheels"], "no wheels for Python 3.10"),
        (["--python"], "--python needs a value"),
        (["one", "two"], "two folders: one and two"),
        (["no/such/folder"], "cannot create no/such/folder"),
        ([SCRIPTS], "exists and was not made by this script"),
    ],
)
def test_a_folder_that_cannot_be_created_is_rejected_in_one_line(
    arguments: list[object], why: str, tmp_path: Path
) -> None:
    ended = run("env", "-C", tmp_path, SCRIPTS / "wheels.sh", *arguments)
    assert (ended.returncode, ended.stdout) == (2, "")
    (line,) = ended.stderr.splitlines()
    assert line.startswith("wheels.sh: ")
    assert why in line
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="session")
def uv_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The uv of this checkout as a wheel."""
    uv = shutil.which(SCRIPTS.parent / ".tools/bin/uv") or shutil.which("uv")
    if uv is None:
        skip_or_fail("needs uv: scripts/setup.sh installs it")
    file = tmp_path_factory.mktemp("uv") / "uv-1-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as wheel:
        wheel.write(uv, "uv-1.data/scripts/uv")
    return file


def own_wheel(folder: Path, version: str, says: str) -> str:
    """A kinect-vo that only tells its version; its line in a list of requirements."""
    file = folder / f"kinect_vo-{version}-py3-none-any.whl"
    about = f"kinect_vo-{version}.dist-info"
    with zipfile.ZipFile(file, "w") as wheel:
        wheel.writestr("kinect_vo_small.py", f"def main():\n    {says}\n")
        wheel.writestr(
            f"{about}/METADATA", f"Metadata-Version: 2.1\nName: kinect-vo\nVersion: {version}\n"
        )
        wheel.writestr(
            f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        wheel.writestr(
            f"{about}/entry_points.txt", "[console_scripts]\nkinect-vo = kinect_vo_small:main\n"
        )
        wheel.writestr(f"{about}/RECORD", "")
    return f"kinect-vo=={version} --hash=sha256:{hashlib.sha256(file.read_bytes()).hexdigest()}\n"


def make_folder(
    folder: Path,
    *wheels: Path,
    version: str = "1",
    says: str = "print('kinect-vo', 1)",
    machine: str = MACHINE,
) -> Path:
    """A folder such as wheels.sh makes, with a small kinect-vo and these wheels."""
    (folder / "wheels").mkdir(parents=True)
    for wheel in wheels:
        shutil.copy(wheel, folder / "wheels")
    for name in ("offline/install.sh", "steps.sh", "debian.sh"):
        shutil.copy(SCRIPTS / name, folder)
    (folder / "requirements.txt").write_text(own_wheel(folder / "wheels", version, says))
    python = f"3.{sys.version_info.minor}"
    (folder / "made_for.sh").write_text(
        f"machine={machine}\npython_version={python}\ndebian_release=\n"
    )
    names = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    sums = [f"{hashlib.sha256((folder / n).read_bytes()).hexdigest()}  {n}\n" for n in names]
    (folder / "SHA256SUMS").write_text("".join(sums))
    return folder


def test_a_later_version_that_does_not_start_leaves_the_old_one(
    tmp_path: Path, uv_wheel: Path
) -> None:
    good, target = make_folder(tmp_path / "good", uv_wheel), tmp_path / "installed"
    ended = run(good / "install.sh", target)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert f"kinect-vo 1 is installed: {target}/bin/kinect-vo " in ended.stdout
    broken = make_folder(tmp_path / "broken", uv_wheel, version="2", says="raise SystemExit('no')")
    ended = run(broken / "install.sh", target)
    assert (ended.returncode, ended.stderr.split("\n")[-2]) == (
        1, "install.sh: the installed kinect-vo does not start",
    )  # fmt: skip
    assert run(target / "bin" / "kinect-vo").stdout == "kinect-vo 1\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken", "good", "installed"]


def test_a_folder_for_another_machine_is_refused(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "folder", machine="riscv64")
    ended = run(folder / "install.sh", tmp_path / "installed")
    assert (ended.returncode, len(ended.stderr.splitlines())) == (2, 1)
    assert "this folder is for riscv64" in ended.stderr
    assert not (tmp_path / "installed").exists()


def test_a_damaged_copy_is_detected_before_the_installation(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "folder")
    (folder / "wheels" / "kinect_vo-1-py3-none-any.whl").write_bytes(b"half")
    ended = run(folder / "install.sh", tmp_path / "installed")
    assert ended.returncode == 1
    assert "this step failed: Checking that this folder is complete" in ended.stderr
    assert not (tmp_path / "installed").exists()


def test_a_folder_without_kinect_vo_is_not_overwritten(tmp_path: Path) -> None:
    folder, target = make_folder(tmp_path / "folder"), tmp_path / "mine"
    target.mkdir()
    (target / "letter.txt").write_text("dear")
    ended = run(folder / "install.sh", target)
    assert (ended.returncode, len(ended.stderr.splitlines())) == (2, 1)
    assert "is there already and not a kinect-vo" in ended.stderr
    assert (target / "letter.txt").read_text() == "dear"


@pytest.mark.parametrize("arguments", [["--quick"], ["one", "two"], ["/nowhere/at/all"]])
def test_invalid_arguments_are_rejected_in_one_line(arguments: list[str], tmp_path: Path) -> None:
    ended = run(make_folder(tmp_path / "folder") / "install.sh", *arguments)
    assert (ended.returncode, len(ended.stderr.splitlines())) == (2, 1)
