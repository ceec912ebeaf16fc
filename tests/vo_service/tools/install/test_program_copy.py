"""The copy of the program: complete, readable, independent of the checkout."""

import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from tests.vo_service.tools.install.conftest import make_tree
from vo_service.tools.install import program
from vo_service.tools.install.program import (
    PROGRAM_FOLDER,
    install_program,
    list_files,
    remove_program,
    runtime_distributions,
)

pytestmark = pytest.mark.subprocess

CHECKOUT = Path(__file__).parents[4]


def install_quietly(tree: Path) -> bool:
    """Install without output."""
    return install_program(tree, lambda step: None)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tree with a copy of the program; tests must not change it."""
    with pytest.MonkeyPatch.context() as patch:
        tree = make_tree(tmp_path_factory.mktemp("copy") / "tree", patch)
        assert install_quietly(tree)
    return tree


@pytest.fixture
def small_program(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the program by a small package."""
    monkeypatch.setattr(program, "runtime_distributions", lambda: [distribution("pyusb")])


def test_packages_of_the_service_are_copied_and_those_of_tests_are_not() -> None:
    names = {package.name.lower() for package in runtime_distributions()}
    assert names >= {"kinect-vo", "numpy", "numba", "llvmlite", "eclipse-zenoh", "pyusb"}
    assert names.isdisjoint({"pytest", "mypy", "ruff", "hypothesis", "evo"})


@pytest.mark.parametrize("name", ["kinect-vo", "numpy", "eclipse-zenoh"])
def test_every_file_is_there_and_stays_below_site_packages(name: str) -> None:
    files = list(list_files(distribution(name)))
    assert len(files) > 5
    assert all(source.is_file() for source, _ in files)
    assert not [path for _, path in files if path.is_absolute() or ".." in path.parts]


def test_the_copy_is_the_program_and_does_not_refer_to_the_checkout(copy: Path) -> None:
    script = (
        "import vo_service.tools.install.systemd as u; "
        "print(u.__file__, len(u.read_service_file(u.DROP_IN)))"
    )
    command = [str(copy / PROGRAM_FOLDER / "bin" / "python3"), "-I", "-c", script]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout
    assert output.startswith(f"{copy / PROGRAM_FOLDER}/")
    # Our own files may mention the folder of the checkout.
    others = [p for p in (copy / PROGRAM_FOLDER).rglob("*") if "vo_service" not in p.parts]
    texts = [p for p in others if p.is_file() and p.suffix != ".pyc"]
    assert not [path for path in texts if str(CHECKOUT).encode() in path.read_bytes()]


def test_everybody_can_read_and_run_it(copy: Path) -> None:
    modes = [path.stat().st_mode for path in (copy / PROGRAM_FOLDER).rglob("*")]
    assert all(mode & 0o004 for mode in modes)
    script = copy / PROGRAM_FOLDER / "bin" / "kinect-vo"
    assert script.stat().st_mode & 0o777 == 0o755
    assert script.read_text().startswith("#!/opt/kinect-vo/bin/python3\n")


def test_the_compiled_files_are_valid(copy: Path) -> None:
    source = next((copy / PROGRAM_FOLDER).rglob("drivers/core/__init__.py"))
    compiled = next((source.parent / "__pycache__").glob("__init__.*.pyc")).read_bytes()
    assert int.from_bytes(compiled[8:12], "little") == int(source.stat().st_mtime)
    assert b"/opt/kinect-vo/lib/" in compiled


def test_the_same_program_is_not_copied_again(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = list(list_files(distribution("pyusb")))
    monkeypatch.setattr(program, "list_files", lambda package: iter(files))
    assert install_quietly(tree)
    assert not install_quietly(tree)
    files.pop()
    assert install_quietly(tree)


@pytest.mark.usefixtures("small_program")
def test_a_copy_that_does_not_run_keeps_the_old_one(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_quietly(tree)
    (tree / PROGRAM_FOLDER / "installed.txt").write_text("an older one")
    monkeypatch.undo()
    monkeypatch.setattr(program, "runtime_distributions", lambda: [distribution("kinect-vo")])
    with pytest.raises(UserFacingError, match=r"does not run .*Error"):
        install_quietly(tree)
    assert (tree / PROGRAM_FOLDER / "installed.txt").read_text() == "an older one"
    assert [path.name for path in (tree / "opt").iterdir()] == ["kinect-vo"]


def test_a_python_that_the_service_cannot_see_is_rejected(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program, "HIDDEN_FOLDERS", (Path(sys.executable).resolve().parent,))
    with pytest.raises(UserFacingError, match="a service cannot run a Python below"):
        install_quietly(tree)
    assert not (tree / "opt").exists()


@pytest.mark.usefixtures("small_program")
def test_removal_can_be_repeated(tree: Path) -> None:
    install_quietly(tree)
    assert remove_program(tree)
    assert not remove_program(tree)
