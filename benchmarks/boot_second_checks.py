"""Checks after the second boot, and of the other units."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import zenoh

from benchmarks.boot_computer import RENDER_TIMEOUT_S, BootedComputer
from benchmarks.boot_listener import BootListener, running_listener
from tests.ports import free_port

ZENOH_PROFILES = Path(__file__).parents[1] / "config" / "zenoh"
INSTALLED = "/usr/local/bin/kinect-vo"
# Kernels are compiled at 30 % of a processor.
INSTALL_TIMEOUT_S = 900.0
KEYS = ("ca.pem", "tls.pem", "tls.key")


def check_starts_at_boot(computer: BootedComputer) -> str:
    """The service starts at boot."""
    taken_s = computer.listener.wait_for_poses(30, RENDER_TIMEOUT_S)
    return f"poses {taken_s:.0f} s after the boot"


def check_reinstall_does_not_restart(computer: BootedComputer) -> str:
    """Installing the same program again does not restart the service."""
    main = computer.unit_property("MainPID")
    command = [computer.command, "service", "install"]
    output = computer.container.run(*command, limit_s=INSTALL_TIMEOUT_S, check=True)
    changed = [line for line in output.splitlines() if line.endswith(": written")]
    assert (computer.unit_property("MainPID") == main) == (not changed), f"restarted: {changed}"
    computer.listener.wait_for_poses(30, RENDER_TIMEOUT_S)
    return f"changed: {', '.join(changed) or 'nothing'}"


def check_named_instance(computer: BootedComputer) -> str:
    """kinect-vo@front runs beside kinect-vo, with the same room in its cache."""
    port = free_port()
    config = computer.tree / "etc/kinect-vo/front.toml"
    config.write_text(computer.config_text().replace(str(computer.port), str(port)))
    computer.container.shell(
        "cp -a /var/cache/private/kinect-vo /var/cache/private/kinect-vo-front"
    )
    command = [computer.command, "service", "install", "--name", "front", "--enable"]
    computer.container.run(*command, limit_s=INSTALL_TIMEOUT_S, check=True)
    with running_listener(port, "front") as listener:
        taken_s = listener.wait_for_poses(30, RENDER_TIMEOUT_S)
    computer.listener.wait_for_poses(30, RENDER_TIMEOUT_S)
    computer.container.run("systemctl", "disable", "--now", "kinect-vo@front", check=True)
    return f"poses on front/odom after {taken_s:.0f} s, and still on kinect/odom"


def check_tls_access(computer: BootedComputer) -> str:
    """A reader receives poses over TLS, with the drop-in, the profile and root's private keys."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder) / "keys"
        command = [computer.command, "certificates", str(keys), "--host", "localhost"]
        subprocess.run([*command, "--reader", "reader"], stdout=subprocess.DEVNULL, check=True)
        _install_tls(computer, keys / "localhost", port)
        profile = (ZENOH_PROFILES / "reader-tls.json5").read_text()
        profile = profile.replace("robot1.local:7451", f"localhost:{port}")
        for name in KEYS:
            profile = profile.replace(f'"{name}"', f'"{keys / "reader" / name}"')
        with zenoh.open(zenoh.Config.from_json5(profile)) as session:
            taken_s = BootListener(session, "kinect").wait_for_poses(30, RENDER_TIMEOUT_S)
    return f"poses over TLS after {taken_s:.0f} s"


def _install_tls(computer: BootedComputer, keys: Path, port: int) -> None:
    folder = computer.tree / "etc/kinect-vo"
    for name in KEYS:
        shutil.copy(keys / name, folder / name)
        (folder / name).chmod(0o600)
    profile = (ZENOH_PROFILES / "robot-tls.json5").read_text()
    profile = profile.replace(":7451", f":{port}").replace(":7450", f":{computer.port}")
    (folder / "robot-tls.json5").write_text(profile)
    file = 'config_file = "/etc/kinect-vo/robot-tls.json5"'
    config = computer.config_text().replace("[zenoh]", f"[zenoh]\n{file}")
    (folder / "kinect.toml").write_text(config)
    command = [computer.command, "service", "install", "--network-tls"]
    computer.container.run(*command, limit_s=INSTALL_TIMEOUT_S, check=True)
    computer.container.run(
        "systemctl", "restart", "kinect-vo", limit_s=INSTALL_TIMEOUT_S, check=True
    )


def check_replay_unit(computer: BootedComputer) -> str:
    """The replay unit stops the live service and publishes poses; and vice versa."""
    computer.write_config()
    record = (
        "/opt/kinect-vo/bin/kinect-vo record --camera synthetic --seconds 2 /srv/kinect-vo/room"
    )
    cache = "CACHE_DIRECTORY=/var/cache/private/kinect-vo"
    computer.container.shell(
        f"mkdir -p /srv/kinect-vo; rm -rf /srv/kinect-vo/room; {cache} {record}"
    )
    computer.container.run("systemctl", "start", "kinect-vo-replay@room", check=True)
    live = computer.unit_property("ActiveState")
    assert live == "inactive", f"the live service is {live}"
    taken_s = computer.listener.wait_for_poses(100, RENDER_TIMEOUT_S)
    state = computer.container.run("systemctl", "is-active", "kinect-vo-replay@room").strip()
    computer.container.run("systemctl", "start", "kinect-vo", limit_s=INSTALL_TIMEOUT_S, check=True)
    after = computer.container.run("systemctl", "is-active", "kinect-vo-replay@room").strip()
    assert (state, after) == ("active", "inactive"), (state, after)
    return f"100 poses of 2 s of recording after {taken_s:.0f} s"


def check_uninstall_keeps_user_files(computer: BootedComputer) -> str:
    """`uninstall` keeps the user's files, and `--purge` removes them."""
    computer.container.run(INSTALLED, "service", "uninstall", check=True)
    left = _leftover_files(computer.tree)
    assert "etc/kinect-vo" in left, f"left: {left}"
    assert all(path.startswith(("etc/kinect-vo", "var/")) for path in left), f"left: {left}"
    computer.container.run(computer.command, "service", "uninstall", "--purge", check=True)
    assert _leftover_files(computer.tree) == [], f"left: {_leftover_files(computer.tree)}"
    return f"kept: {', '.join(left)}; with --purge nothing"


def _leftover_files(tree: Path) -> list[str]:
    """Files of kinect-vo in the tree, without this benchmark's quota.conf."""
    places = [
        "opt/*",
        "etc/kinect-vo",
        "etc/modprobe.d/kinect*",
        "etc/systemd/system/kinect-vo*.service",
        "etc/udev/rules.d/*",
        "usr/local/bin/*",
        "var/cache/private/*",
        "var/lib/private/*",
    ]
    return sorted(str(p.relative_to(tree)) for place in places for p in tree.glob(place))


SECOND_BOOT: tuple[Callable[[BootedComputer], str], ...] = (
    check_starts_at_boot,
    check_reinstall_does_not_restart,
    check_named_instance,
    check_tls_access,
    check_replay_unit,
    check_uninstall_keeps_user_files,
)
