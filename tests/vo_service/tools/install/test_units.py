"""The units, as systemd's own tools judge them."""

import re
import subprocess
from pathlib import Path

import pytest

from drivers.core.errors import InputError
from tests.simulators.requirements import require_program
from vo_service.config import read_config
from vo_service.tools.install.program import SCRIPT_PATH
from vo_service.tools.install.unit import (
    DROP_IN,
    SERVICE_FILES,
    UNITS,
    ServiceUnit,
    read_service_file,
)

MOST_EXPOSURE = 1.6


def analyzed(*arguments: str) -> str:
    """What systemd-analyze says, complaints too."""
    done = subprocess.run(
        [require_program("systemd-analyze", "systemd"), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=100,
        check=False,
    )
    return done.stdout


def placed(folder: Path) -> Path:
    """The units with a program that is there, and the drop-in, as they would be installed."""
    for name in UNITS:
        (folder / name).write_text(read_service_file(name).replace(f"/{SCRIPT_PATH}", "/bin/true"))
    drop_in = folder / f"{UNITS[0]}.d" / DROP_IN
    drop_in.parent.mkdir()
    drop_in.write_text(read_service_file(DROP_IN))
    return folder


def lines_of(name: str) -> list[str]:
    """What a unit says, without remarks."""
    return [
        line for line in read_service_file(name).splitlines() if line and not line.startswith("#")
    ]


@pytest.mark.subprocess
@pytest.mark.parametrize("name", UNITS)
def test_systemd_has_nothing_to_say_against_a_unit(tmp_path: Path, name: str) -> None:
    assert analyzed("verify", str(placed(tmp_path) / name)) == ""


@pytest.mark.subprocess
def test_systemd_would_say_so_if_a_key_were_wrong(tmp_path: Path) -> None:
    unit = placed(tmp_path) / UNITS[0]
    unit.write_text(unit.read_text().replace("WatchdogSec=", "WatchdogSek="))
    assert "WatchdogSek" in analyzed("verify", str(unit))


@pytest.mark.subprocess
@pytest.mark.parametrize("name", UNITS)
def test_a_unit_is_little_exposed(tmp_path: Path, name: str) -> None:
    said = analyzed("security", "--offline=true", str(placed(tmp_path) / name))
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", said)
    assert found is not None, said
    assert float(found[1]) <= MOST_EXPOSURE


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


def test_the_rehearsal_is_confined_like_the_service_but_without_devices() -> None:
    begin = "DynamicUser=yes"
    service, rehearsal = lines_of(UNITS[0]), lines_of(UNITS[2])
    confined = [line.replace("-replay-%i", "") for line in rehearsal[rehearsal.index(begin) :]]
    missing = [line for line in service[service.index(begin) :] if line not in confined]
    devices = ["SupplementaryGroups=plugdev", "DeviceAllow=char-usb_device rw"]
    assert missing == [*devices, "[Install]", "WantedBy=multi-user.target"]


def test_the_tls_drop_in_hands_over_the_keys_that_the_profile_names() -> None:
    profile = (Path(__file__).parents[4] / "config" / "zenoh" / "robot-tls.json5").read_text()
    handed = [
        line.split("=")[1].split(":")[0] for line in lines_of(DROP_IN) if "Credential" in line
    ]
    assert handed == ["ca.pem", "tls.pem", "tls.key"]
    assert all(f'"{name}"' in profile for name in handed)


def test_the_first_configuration_is_right() -> None:
    config = read_config(SERVICE_FILES / "kinect.toml")
    assert config.camera.source == "freenect"


def test_a_checkout_shows_the_units_where_one_looks_for_them() -> None:
    assert (Path(__file__).parents[4] / "systemd").resolve() == SERVICE_FILES


@pytest.mark.parametrize("name", ["a b", "../x", "front/left", "-x", "%i", "x" * 65])
def test_a_name_that_systemd_would_not_take_as_it_is_is_refused(name: str) -> None:
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
