"""What a program imports from `drivers` and from `vo_service`."""

import inspect
import subprocess
import sys
from types import ModuleType

import pytest

import drivers
import vo_service

LIBRARIES = ("cv2", "matplotlib", "numba", "numpy", "pyudev", "rerun", "scipy", "usb", "zenoh")


def libraries_loaded_by(code: str) -> set[str]:
    """The heavy libraries that a new interpreter has loaded after running the code."""
    report = f"\nimport sys\nprint(*(name for name in {LIBRARIES} if name in sys.modules))"
    ended = subprocess.run(
        [sys.executable, "-c", code + report], capture_output=True, text=True, check=True
    )
    return set(ended.stdout.split())


@pytest.mark.subprocess
def test_importing_the_packages_loads_no_library() -> None:
    assert libraries_loaded_by("import drivers, vo_service") == set()


@pytest.mark.subprocess
def test_the_client_loads_only_zenoh_and_numpy() -> None:
    assert libraries_loaded_by("from vo_service import PoseClient") == {"numpy", "zenoh"}


@pytest.mark.subprocess
def test_cameras_and_odometry_load_neither_zenoh_nor_rerun() -> None:
    code = "from drivers import open_camera\nfrom vo_service import make_odometry\nmake_odometry()"
    assert not libraries_loaded_by(code) & {"rerun", "zenoh"}


@pytest.mark.parametrize("package", [drivers, vo_service])
def test_every_public_name_can_be_imported_and_has_a_docstring(package: ModuleType) -> None:
    assert sorted(package.__all__) == dir(package)
    for name in package.__all__:
        thing = getattr(package, name)
        assert not callable(thing) or inspect.getdoc(thing), name


@pytest.mark.parametrize("package", [drivers, vo_service])
def test_another_name_is_an_error(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'x'"):
        package.x  # noqa: B018
