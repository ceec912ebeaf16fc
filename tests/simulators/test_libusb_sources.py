"""The C sources compile without warnings, and have the same control file as Python."""

import ctypes
import subprocess
from pathlib import Path

import pytest
import usb.core

from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_control import KinectControl, StreamControl
from tests.simulators.libusb_build import SOURCES, compiler

pytestmark = [pytest.mark.subprocess, pytest.mark.usefixtures("simulated_libusb")]


def compile_program(code: str, folder: Path) -> Path:
    (folder / "code.c").write_text(code)
    command = [compiler(), "-std=gnu11", "-I", str(SOURCES), "-o", "code", "code.c"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "code"


def test_no_warnings(tmp_path: Path) -> None:
    sources = sorted(SOURCES.glob("*.c"))
    options = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wno-missing-field-initializers"]
    command = [compiler(), *options, "-Werror", "-fsyntax-only", *map(str, sources)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 0, result.stderr


def test_every_field_of_the_control_file_is_where_python_writes_it(tmp_path: Path) -> None:
    structures = {"control": KinectControl, "stream_control": StreamControl}
    places = [(c, field[0]) for c, python in structures.items() for field in python._fields_]
    prints = "".join(f'printf("%zu\\n", offsetof(struct {c}, {name}));' for c, name in places)
    code = f"#include <stddef.h>\n#include <stdio.h>\n#include <control.h>\nint main(){{{prints}}}"
    output = subprocess.check_output([compile_program(code, tmp_path)], text=True)
    expected = [getattr(structures[c], name).offset for c, name in places]
    assert [int(line) for line in output.split()] == expected


def test_a_control_file_of_another_version_is_rejected(
    simulate_kinect: SimulateKinect, capfd: pytest.CaptureFixture[str]
) -> None:
    kinect = simulate_kinect()
    with kinect.control_file.open("r+b") as file:
        file.seek(KinectControl.size.offset)
        file.write(bytes(ctypes.c_uint32(7)))
    kinect.activate()
    assert usb.core.find(idVendor=0x045E) is None
    assert "not a control file of this version" in capfd.readouterr().err


def test_without_a_kinect_the_bus_has_its_root_hub_alone(
    simulate_kinect: SimulateKinect, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulate_kinect().activate()
    monkeypatch.setenv("KINECT_SIMULATOR", "")
    assert [device.idVendor for device in usb.core.find(find_all=True)] == [0x1D6B]


def test_a_kinect_hangs_on_a_hub_of_its_own(simulate_kinect: SimulateKinect) -> None:
    simulate_kinect().activate()
    camera = usb.core.find(idProduct=0x02AE)
    assert camera.port_numbers == (1, 2)
    assert camera.parent.parent.idVendor == 0x1D6B
    assert (camera.manufacturer, camera.product) == ("Microsoft", "Xbox NUI Camera")
