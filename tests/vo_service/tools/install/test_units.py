"""The systemd units, checked by systemd-analyze."""

import re
import subprocess
from pathlib import Path

import pytest

from drivers.core import InputError
from tests.simulators.requirements import require_program
from vo_service.config import read_config
from vo_service.tools.install.program import SCRIPT_PATH
from vo_service.tools.install.systemd import (
    DROP_IN,
    SERVICE_FILES,
    UNITS,
    ServiceUnit,
    read_service_file,
)

MAX_EXPOSURE = 1.6


def analyze(*arguments: str) -> str:
    """Return the output of systemd-analyze, with its errors."""
    process = subprocess.run(
        [require_program("systemd-analyze", "systemd"), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=100,
        check=False,
    )
    return process.stdout


def install_units(folder: Path) -> Path:
    """Install the units, with an existing program, and the drop-in."""
    for name in UNITS:
        (folder / name).write_text(read_service_file(name).replace(f"/{SCRIPT_PATH}", "/bin/true"))
    drop_in = folder / f"{UNITS[0]}.d" / DROP_IN
    drop_in.parent.mkdir()
    drop_in.write_text(read_service_file(DROP_IN))
    return folder


def lines_of(name: str) -> list[str]:
    """Return the lines of a unit without comments."""
    return [
        line for line in read_service_file(name).splitlines() if line and not line.startswith("#")
    ]


@pytest.mark.subprocess
@pytest.mark.parametrize("name", UNITS)
def test_systemd_accepts_each_unit(tmp_path: Path, name: str) -> None:
    assert analyze("verify", str(install_units(tmp_path) / name)) == ""


@pytest.mark.subprocess
def test_systemd_reports_a_wrong_key(tmp_path: Path) -> None:
    unit = install_units(tmp_path) / UNITS[0]
    unit.write_text(unit.read_text().replace("WatchdogSec=", "WatchdogSek="))
    assert "WatchdogSek" in analyze("verify", str(unit))


@pytest.mark.subprocess
@pytest.mark.parametrize("name", UNITS)
def test_a_unit_has_low_exposure(tmp_path: Path, name: str) -> None:
    output = analyze("security", "--offline=true", str(install_units(tmp_path) / name))
    match = re.search(r"Overall exposure level for \S+: ([\d.]+)", output)
    assert match is not None, output
    assert float(match[1]) <= MAX_EXPOSURE


def test_the_named_unit_differs_only_by_its_name() -> None:
    pairs = [
        (plain, named)
        for plain, named in zip(lines_of(UNITS[0]), lines_of(UNITS[1]), strict=True)
        if plain != named
    ]
    assert pairs
    for plain, named in pairs:
        without_name = named.replace(" --prefix %i", "").replace("-%i", "").replace(" (%i)", "")
        assert without_name.replace("%i.toml", "kinect.toml") == plain


def test_the_replay_unit_is_sandboxed_like_the_service_but_without_devices() -> None:
    begin = "DynamicUser=yes"
    service, replay = lines_of(UNITS[0]), lines_of(UNITS[2])
    sandbox_lines = [line.replace("-replay-%i", "") for line in replay[replay.index(begin) :]]
    missing = [line for line in service[service.index(begin) :] if line not in sandbox_lines]
    devices = ["SupplementaryGroups=plugdev", "DeviceAllow=char-usb_device rw"]
    assert missing == [*devices, "[Install]", "WantedBy=multi-user.target"]


def test_the_tls_drop_in_passes_the_keys_that_the_profile_names() -> None:
    profile = (Path(__file__).parents[4] / "config" / "zenoh" / "robot-tls.json5").read_text()
    names = [line.split("=")[1].split(":")[0] for line in lines_of(DROP_IN) if "Credential" in line]
    assert names == ["ca.pem", "tls.pem", "tls.key"]
    assert all(f'"{name}"' in profile for name in names)


def test_the_default_configuration_is_valid() -> None:
    config = read_config(SERVICE_FILES / "kinect.toml")
    assert config.camera.source == "freenect"


def test_the_checkout_links_to_the_units() -> None:
    assert (Path(__file__).parents[4] / "systemd").resolve() == SERVICE_FILES


@pytest.mark.parametrize("name", ["a b", "../x", "front/left", "-x", "%i", "x" * 65])
def test_an_invalid_unit_name_is_rejected(name: str) -> None:
    with pytest.raises(InputError, match="--name"):
        ServiceUnit(name)


def test_a_name_gives_unit_and_configuration() -> None:
    assert (ServiceUnit().unit_name, str(ServiceUnit().config)) == (
        "kinect-vo.service",
        "etc/kinect-vo/kinect.toml",
    )
    front = ServiceUnit("front")
    assert (front.unit_name, str(front.config)) == (
        "kinect-vo@front.service",
        "etc/kinect-vo/front.toml",
    )
