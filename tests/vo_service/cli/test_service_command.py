"""`kinect-vo service`: what it writes into a tree, what it says, and what it leaves alone."""

import os
from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.simulators.requirements import require_program
from tests.vo_service.cli.cli_runner import CommandResult, KinectVo
from tests.vo_service.tools.install.conftest import tree
from vo_service.tools.install import program, systemd
from vo_service.tools.install.systemd import UNITS, read_service_file

pytestmark = pytest.mark.subprocess

__all__ = ["tree"]
CONFIG = "etc/kinect-vo/kinect.toml"
Service = Callable[..., CommandResult]


@pytest.fixture
def service(tree: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch) -> Service:
    """``service("install", ...)`` below the tree; in place of the program, a small package."""
    monkeypatch.setattr(program, "runtime_distributions", lambda: [distribution("pyusb")])
    return lambda action, *rest: kinect_vo("service", action, "--root", tree, *rest)


def files(root: Path) -> set[str]:
    """All files and links, but for those of the program."""
    paths = {str(p.relative_to(root)) for p in root.rglob("*") if p.is_symlink() or p.is_file()}
    return {path for path in paths if not path.startswith("opt/")}


def test_installing_writes_units_rules_command_and_a_default_configuration(
    tree: Path, service: Service
) -> None:
    before = files(tree)
    outcome = service("install")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert files(tree) - before == {
        CONFIG,
        "etc/modprobe.d/kinect-vo.conf",
        "etc/udev/rules.d/59-kinect-vo.rules",
        "usr/local/bin/kinect-vo",
        *(f"etc/systemd/system/{name}" for name in UNITS),
    }
    assert "start it with: systemctl enable --now kinect-vo.service" in outcome.out


def test_installing_again_changes_nothing(tree: Path, service: Service) -> None:
    service("install")
    before = {path: (tree / path).lstat().st_mtime_ns for path in files(tree)}
    outcome = service("install")
    assert ": written" not in outcome.out.replace("opt/kinect-vo: written", "")
    assert {path: (tree / path).lstat().st_mtime_ns for path in files(tree)} == before


def test_the_configuration_is_kept_and_an_old_unit_is_replaced(
    tree: Path, service: Service
) -> None:
    service("install")
    (tree / CONFIG).write_text('schema = 1\n[camera]\nsource = "synthetic"\n')
    (tree / "etc/systemd/system" / UNITS[0]).write_text("# of an older version\n")
    outcome = service("install")
    assert f"{tree / CONFIG}: kept unchanged" in outcome.out
    assert "synthetic" in (tree / CONFIG).read_text()
    assert (tree / "etc/systemd/system" / UNITS[0]).read_text() == read_service_file(UNITS[0])


def test_an_enabled_service_starts_at_boot_until_it_is_uninstalled(
    tree: Path, service: Service
) -> None:
    require_program("systemctl", "systemd")
    wanted = tree / "etc/systemd/system/multi-user.target.wants/kinect-vo@front.service"
    assert service("install", "--name", "front", "--enable").code == 0
    assert wanted.readlink() == Path("/etc/systemd/system/kinect-vo@.service")
    assert (tree / "etc/kinect-vo/front.toml").exists()
    assert service("uninstall").code == 0
    assert not wanted.is_symlink()


def test_the_network_drop_in_is_installed_only_on_request(tree: Path, service: Service) -> None:
    service("install")
    drop_in = tree / "etc/systemd/system/kinect-vo.service.d/network-tls.conf"
    assert not drop_in.exists()
    service("install", "--network-tls")
    assert "LoadCredential=tls.key" in drop_in.read_text()
    service("uninstall")
    assert not drop_in.parent.exists()


def test_uninstalling_keeps_configuration_and_data(tree: Path, service: Service) -> None:
    before = files(tree)
    service("install")
    incident = tree / "var/lib/private/kinect-vo/incidents/one"
    incident.mkdir(parents=True)
    (tree / "var/lib/kinect-vo").symlink_to("private/kinect-vo")
    outcome = service("uninstall")
    assert outcome.code == 0
    assert files(tree) - before == {CONFIG, "var/lib/kinect-vo"}
    assert incident.exists()
    assert not (tree / "opt/kinect-vo").exists()
    assert service("uninstall", "--purge").code == 0
    assert files(tree) == before
    assert not incident.exists()


def test_a_command_of_another_program_is_kept(tree: Path, service: Service) -> None:
    command = tree / "usr/local/bin/kinect-vo"
    command.parent.mkdir(parents=True)
    command.write_text("of another\n")
    service("install")
    service("uninstall", "--purge")
    assert command.read_text() == "of another\n"


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        (CONFIG, "schema = 1\n[camera]\nsource = 7\n", "kinect.toml:3: key"),
        ("etc/group", "", "groupadd"),
    ],
)
def test_an_error_that_would_prevent_the_start_is_reported_before_any_change(
    tree: Path, service: Service, path: str, text: str, message: str
) -> None:
    (tree / path).parent.mkdir(exist_ok=True)
    (tree / path).write_text(text)
    before = files(tree)
    outcome = service("install")
    assert outcome.code in (1, 2)
    assert outcome.err.count("\n") == 1
    assert message in outcome.err
    assert files(tree) == before


def test_installed_files_are_readable_by_all_users(tree: Path, service: Service) -> None:
    before = os.umask(0o077)
    try:
        service("install")
        assert os.umask(0o077) == 0o077
    finally:
        os.umask(before)
    written = [tree / path for path in files(tree) if path != "etc/group"]
    assert all(path.stat(follow_symlinks=False).st_mode & 0o004 for path in written)
    assert all(p.stat().st_mode & 0o005 == 0o005 for path in written for p in path.parents[:2])


def test_a_user_without_root_gets_the_command_for_root(
    kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    outcome = kinect_vo("service", "install", "--name", "front", "--enable")
    assert outcome.code == 1
    assert "run: sudo " in outcome.err
    assert outcome.err.endswith("service install --name front --enable\n")


def test_without_systemd_one_line_names_the_alternatives(
    kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(systemd, "RUNTIME_FOLDER", Path("/nowhere"))
    outcome = kinect_vo("service", "uninstall")
    assert (outcome.code, outcome.out) == (1, "")
    assert "systemd does not run here" in outcome.err


def test_the_files_can_be_printed(kinect_vo: KinectVo) -> None:
    for name in (*UNITS, "network-tls.conf", "kinect.toml"):
        assert kinect_vo("service", "show", name).out == read_service_file(name)
