"""Checks of the systemd units on a booting computer: a Debian with systemd, in a container.

    sudo .venv/bin/python -m benchmarks boot [--tree DIR] [--mirror URL]

The first run creates the Debian with debootstrap (a minute or two). Each run boots it, installs the
service from this checkout with its own command, and runs the checks. The container shares the
network of this computer, so a subscriber outside receives the poses. A run takes about ten minutes.
Exit code 0 if all checks pass, 1 if one fails, 77 where no container can run.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import zenoh

from benchmarks.boot_container import (
    RECOVERY_TIMEOUT_S,
    RENDER_TIMEOUT_S,
    UNIT,
    BootedComputer,
    PoseCounter,
    bootstrap_tree,
    counting_poses,
    running_container,
    unsupported_reason,
    wait_for,
)
from benchmarks.harness import option
from tests.ports import free_port

WATCHDOG_S = 10.0
MIN_POSES_PER_S = 15.0
ZENOH_PROFILES = Path(__file__).parents[1] / "config" / "zenoh"
INSTALLED = "/usr/local/bin/kinect-vo"
KEYS = ("ca.pem", "tls.pem", "tls.key")


def check_cpu_quota(computer: BootedComputer) -> str:
    """Processor quotas work here; the other checks depend on them."""
    run = computer.container.run
    burn = ["sh", "-c", "while :; do :; done"]
    run("systemd-run", "--unit=burn", "-p", "CPUQuota=30%", *burn, check=True)
    time.sleep(4.0)
    process = run("systemctl", "show", "burn", "-p", "MainPID", "--value").strip()
    ticks = int(computer.container.shell(f"cut -d' ' -f14 /proc/{process}/stat"))
    run("systemctl", "stop", "burn")
    assert ticks < 4.0 * 100 * 0.45, f"a process limited to 30 % took {ticks / 4:.0f} %"
    return f"30 % gave {ticks / 4:.0f} %"


def check_install(computer: BootedComputer) -> str:
    """The install command works from the checkout, without compiled kernels, at 30 % CPU."""
    computer.write_config()
    drop_in = computer.tree / "etc/systemd/system/kinect-vo.service.d/quota.conf"
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    drop_in.write_text("[Service]\nCPUQuota=30%\n")
    begin_s = time.monotonic()
    output = computer.kinect_vo("service", "install", "--enable")
    taken_s = time.monotonic() - begin_s
    assert "kinect.toml: kept unchanged" in output
    assert computer.unit_property("ActiveState") == "active"
    assert computer.unit_property("NRestarts") == "0", "it was started more than once"
    compiled = [e["MESSAGE"] for e in computer.journal_entries() if "are ready" in e["MESSAGE"]]
    return f"ready after {taken_s:.0f} s, copying included; {compiled[-1]}"


def check_watchdog_without_camera(computer: BootedComputer) -> str:
    """The watchdog does not restart a service without a camera (the room is being rendered)."""
    time.sleep(2 * WATCHDOG_S)
    with computer.client() as client:
        state = client.status()["state"]
    assert state == "no_camera", state
    assert computer.unit_property("NRestarts") == "0"
    return computer.unit_property("StatusText")


def check_poses_published(computer: BootedComputer) -> str:
    """Poses are published; without a quota, so that the room is rendered sooner."""
    computer.set_cpu_quota("")
    taken_s = computer.counter.wait_for_poses(100, RENDER_TIMEOUT_S)
    assert computer.unit_property("NRestarts") == "0"
    return f"100 poses after {taken_s:.0f} s; {computer.unit_property('StatusText')}"


def check_poses_on_slow_board(computer: BootedComputer) -> str:
    """At 60 % CPU the pose rate is high enough."""
    computer.set_cpu_quota("60%")
    time.sleep(10.0)
    rate = computer.counter.measure_pose_rate(20.0)
    assert rate >= MIN_POSES_PER_S, f"{rate:.1f} poses a second"
    return f"{rate:.1f} poses a second"


def check_watchdog_while_paused(computer: BootedComputer) -> str:
    """The watchdog does not restart a paused service."""
    with computer.client() as client:
        client.command("pause")
        time.sleep(1.0)
        rate = computer.counter.measure_pose_rate(2 * WATCHDOG_S)
        status_text = computer.unit_property("StatusText")
        client.command("resume")
    computer.counter.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    assert rate == 0.0, f"{rate} poses a second while paused"
    assert computer.unit_property("NRestarts") == "0"
    return status_text


def check_reload_of_invalid_config(computer: BootedComputer) -> str:
    """`systemctl reload` reports an invalid configuration until it is fixed."""
    main = computer.unit_property("MainPID")
    computer.write_config(level="loud")
    computer.systemctl("reload", UNIT)
    read_status = partial(computer.unit_property, "StatusText")
    wait_for(lambda: "loud" in read_status(), 20.0, "the configuration error")
    status_text = read_status()
    computer.write_config()
    computer.systemctl("reload", UNIT)
    wait_for(lambda: "loud" not in read_status(), 20.0, "the end of the error")
    assert computer.unit_property("MainPID") == main
    computer.counter.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    return status_text


def check_journal_levels(computer: BootedComputer) -> str:
    """The lines in the journal have their levels: information, warning, error."""
    ours = [e for e in computer.journal_entries() if e.get("SYSLOG_IDENTIFIER") == "kinect-vo"]
    levels = {entry["PRIORITY"] for entry in ours}
    assert {"3", "4"} <= levels, f"only the levels {sorted(levels)}"
    assert not [e for e in ours if e["MESSAGE"].startswith("<") or "Traceback" in e["MESSAGE"]]
    return f"{len(ours)} lines of levels {', '.join(sorted(levels))}"


def check_restart_after_hang(computer: BootedComputer) -> str:
    """The watchdog restarts the service after SIGSTOP of the main process."""
    return _recovery_after_signal(computer, "STOP", "watchdog")


def check_restart_after_crash(computer: BootedComputer) -> str:
    """The service restarts after SIGSEGV, and the recorder writes an incident."""
    before = _incidents(computer)
    outcome = _recovery_after_signal(computer, "SEGV", "core-dump|signal")
    wait_for(lambda: len(_incidents(computer)) > len(before), 30.0, "an incident")
    return f"{outcome}; incident {sorted(set(_incidents(computer)) - set(before))[-1]}"


def check_stop_time(computer: BootedComputer) -> str:
    """`systemctl stop` takes less than 5 s."""
    begin_s = time.monotonic()
    computer.systemctl("stop", UNIT)
    taken_s = time.monotonic() - begin_s
    assert taken_s < 5.0, f"it took {taken_s:.1f} s"
    assert computer.unit_property("Result") == "success", computer.unit_property("Result")
    return f"{taken_s:.1f} s"


def check_no_restart_on_config_error(computer: BootedComputer) -> str:
    """After exit code 2, a configuration error, systemd does not restart the service."""
    computer.write_config(level="loud")
    computer.container.run("systemctl", "start", UNIT)
    time.sleep(8.0)
    state, status = computer.unit_property("ActiveState"), computer.unit_property("ExecMainStatus")
    messages = [e["MESSAGE"] for e in computer.journal_entries() if "loud" in e["MESSAGE"]]
    computer.write_config()
    assert (state, status) == ("failed", "2"), f"{state}, exit code {status}"
    return f"{state}, exit code {status}: {messages[-1]}"


def _recovery_after_signal(computer: BootedComputer, signal: str, results: str) -> str:
    """Send the main process a signal, and wait for poses of the restarted service."""
    restarts, main = int(computer.unit_property("NRestarts")), computer.unit_property("MainPID")
    computer.container.shell(f"kill -{signal} {main}")
    begin_s = time.monotonic()
    wait_for(lambda: int(computer.unit_property("NRestarts")) > restarts, 60.0, "a restart")
    computer.counter.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    taken_s = time.monotonic() - begin_s
    messages = [
        e["MESSAGE"] for e in computer.journal_entries() if "Failed with result" in e["MESSAGE"]
    ]
    assert any(f"'{result}'" in messages[-1] for result in results.split("|")), messages[-1]
    return f"poses again after {taken_s:.0f} s; {messages[-1]}"


def _incidents(computer: BootedComputer) -> list[str]:
    folder = computer.tree / "var/lib/private/kinect-vo/incidents"
    return sorted(path.name for path in folder.glob("*")) if folder.exists() else []


FIRST_BOOT: tuple[Callable[[BootedComputer], str], ...] = (
    check_cpu_quota,
    check_install,
    check_watchdog_without_camera,
    check_poses_published,
    check_poses_on_slow_board,
    check_watchdog_while_paused,
    check_reload_of_invalid_config,
    check_journal_levels,
    check_restart_after_hang,
    check_restart_after_crash,
    check_stop_time,
    check_no_restart_on_config_error,
)


def check_starts_at_boot(computer: BootedComputer) -> str:
    """The service starts at boot."""
    taken_s = computer.counter.wait_for_poses(30, RENDER_TIMEOUT_S)
    return f"poses {taken_s:.0f} s after the boot"


def check_reinstall_does_not_restart(computer: BootedComputer) -> str:
    """Installing the same program again does not restart the service."""
    main = computer.unit_property("MainPID")
    output = computer.kinect_vo("service", "install")
    changed = [line for line in output.splitlines() if line.endswith(": written")]
    assert (computer.unit_property("MainPID") == main) == (not changed), f"restarted: {changed}"
    computer.counter.wait_for_poses(30, RENDER_TIMEOUT_S)
    return f"changed: {', '.join(changed) or 'nothing'}"


def check_named_instance(computer: BootedComputer) -> str:
    """kinect-vo@front runs beside kinect-vo, with the same room in its cache."""
    port = free_port()
    config = computer.tree / "etc/kinect-vo/front.toml"
    config.write_text(computer.config_text().replace(str(computer.port), str(port)))
    computer.container.shell(
        "cp -a /var/cache/private/kinect-vo /var/cache/private/kinect-vo-front"
    )
    computer.kinect_vo("service", "install", "--name", "front", "--enable")
    with counting_poses(port, "front") as counter:
        taken_s = counter.wait_for_poses(30, RENDER_TIMEOUT_S)
    computer.counter.wait_for_poses(30, RENDER_TIMEOUT_S)
    computer.systemctl("disable", "--now", "kinect-vo@front")
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
            taken_s = PoseCounter(session, "kinect").wait_for_poses(30, RENDER_TIMEOUT_S)
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
    computer.kinect_vo("service", "install", "--network-tls")
    computer.systemctl("restart", UNIT)


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
    computer.systemctl("start", "kinect-vo-replay@room")
    live = computer.unit_property("ActiveState")
    assert live == "inactive", f"the live service is {live}"
    taken_s = computer.counter.wait_for_poses(100, RENDER_TIMEOUT_S)
    state = computer.container.run("systemctl", "is-active", "kinect-vo-replay@room").strip()
    computer.systemctl("start", UNIT)
    after = computer.container.run("systemctl", "is-active", "kinect-vo-replay@room").strip()
    assert (state, after) == ("active", "inactive"), (state, after)
    return f"100 poses of 2 s of recording after {taken_s:.0f} s"


def check_uninstall_keeps_user_files(computer: BootedComputer) -> str:
    """`uninstall` keeps the user's files, and `--purge` removes them."""
    computer.container.run(INSTALLED, "service", "uninstall", check=True)
    left = _leftover_files(computer.tree)
    assert "etc/kinect-vo" in left, f"left: {left}"
    assert all(path.startswith(("etc/kinect-vo", "var/")) for path in left), f"left: {left}"
    computer.kinect_vo("service", "uninstall", "--purge")
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


CHECKOUT = Path(__file__).parents[1]
COMMAND = CHECKOUT / ".venv" / "bin" / "kinect-vo"
EXIT_SKIPPED = 77
# Files that an earlier run may have left in the tree.
LEFTOVER_PATHS = (
    "opt/kinect-vo",
    "etc/kinect-vo",
    "srv/kinect-vo",
    "var/lib/private",
    "var/cache/private",
)


@option("--tree", type=Path, default=Path("/var/tmp/kinect-vo-boot"))
@option("--mirror", default="http://deb.debian.org/debian")
def main(args: argparse.Namespace) -> int:
    """Boot twice and print the checks."""
    reason = unsupported_reason() or _python_mismatch()
    if reason:
        print(f"skipped: {reason}")
        return EXIT_SKIPPED
    bootstrap_tree(args.tree, args.mirror)
    _remove_leftovers(args.tree)
    port = free_port()
    failed = _run(args.tree, port, FIRST_BOOT) + _run(args.tree, port, SECOND_BOOT)
    print(f"{failed} of {len(FIRST_BOOT + SECOND_BOOT)} checks failed")
    return int(failed > 0)


def _run(tree: Path, port: int, checks: Sequence[Callable[[BootedComputer], str]]) -> int:
    """Boot and run checks; return the number that fail."""
    log = tree.with_name(f"{tree.name}.log")
    with running_container(tree, [CHECKOUT], log) as container, counting_poses(port) as counter:
        computer = BootedComputer(container, tree, str(COMMAND), counter, port)
        return sum(not _run_check(check, computer) for check in checks)


def _run_check(check: Callable[[BootedComputer], str], computer: BootedComputer) -> bool:
    """Run a check, print a line, and return whether it passes."""
    name = check.__name__.replace("_", " ")
    begin_s = time.monotonic()
    try:
        outcome = check(computer)
    except (AssertionError, subprocess.SubprocessError) as error:
        print(f"FAILED  {name}: {error}", flush=True)
        print(
            "".join(f"        | {e['MESSAGE']}\n" for e in computer.journal_entries()[-12:]), end=""
        )
        return False
    print(f"ok      {name} ({time.monotonic() - begin_s:.0f} s): {outcome}", flush=True)
    return True


def _python_mismatch() -> str:
    """The container runs the checkout's own environment, so it needs the same Python."""
    python = Path(os.path.realpath(sys.executable))
    return "" if python == Path("/usr/bin/python3.11") else f"{python} is not Debian 12's Python"


def _remove_leftovers(tree: Path) -> None:
    for folder in LEFTOVER_PATHS:
        shutil.rmtree(tree / folder, ignore_errors=True)
    for unit in list((tree / "etc/systemd").rglob("kinect-vo*")):
        if unit.is_dir():
            shutil.rmtree(unit)
        elif unit.is_symlink() or unit.exists():
            unit.unlink()
