"""The check on a bare Debian: what it refuses, how failures are reported, what is left behind.

debootstrap, chroot and others are stand-ins here: no network, nothing of this computer changed.
"""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.mount_namespace import AS_ROOT, need_mounts
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

SCRIPT = Path(__file__).parents[2] / "scripts" / "check_bare_debian.sh"
# One that mounts something in the root, as the real one does.
MAKE_A_TREE = """
mkdir -p "$3"; cd "$3"
mkdir -p proc sys dev/pts dev/shm etc/apt/apt.conf.d root var/lib/dpkg
echo 12.99 >etc/debian_version
mount -t tmpfs tmpfs proc
"""

Starts = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def starts(tmp_path: Path) -> Iterator[Starts]:
    """Starts the check with these stand-ins first on its path and an empty folder for its root."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "roots").mkdir()
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str, **stand_ins: str) -> "subprocess.Popen[str]":
        for name, body in ({"git": ""} | stand_ins).items():
            program = tmp_path / "bin" / name.replace("_", "-")
            program.write_text(f"#!/bin/sh\n{body}\n")
            program.chmod(0o755)
        check = subprocess.Popen(
            [SCRIPT, *arguments],
            env=os.environ
            | {
                "PATH": f"{tmp_path}/bin:/usr/sbin:/usr/bin:/sbin:/bin",
                "TMPDIR": f"{tmp_path}/roots",
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(check)
        return check

    yield start
    for check in started:
        check.terminate()
        check.communicate(timeout=60)


def is_left_clean(tmp_path: Path) -> bool:
    """Neither a folder nor a mount is there."""
    mounts = Path("/proc/self/mountinfo").read_text()
    return list((tmp_path / "roots").iterdir()) == [] and str(tmp_path) not in mounts


def test_a_checkout_without_git_is_rejected(starts: Starts, tmp_path: Path) -> None:
    check = starts("test", id="echo 0", git="echo fatal: not a git repository >&2\nexit 128")
    out, err = check.communicate(timeout=60)
    assert (check.returncode, out, len(err.splitlines())) == (2, "", 2)
    assert f"{SCRIPT.parents[1]} has to be a clone" in err
    assert is_left_clean(tmp_path)


@pytest.mark.parametrize("arguments", [["all"], ["--help"], ["demo", "test"], ["demo test"]])
def test_an_unknown_argument_is_refused_in_one_line(arguments: list[str], starts: Starts) -> None:
    check = starts(*arguments)
    out, err = check.communicate(timeout=60)
    assert (check.returncode, out, len(err.splitlines())) == (2, "", 1)
    assert f"{' '.join(arguments)} is unknown: name demo or test" in err


def test_a_user_without_root_gets_one_line(starts: Starts, tmp_path: Path) -> None:
    check = starts(id="echo 1000")
    out, err = check.communicate(timeout=60)
    assert (check.returncode, out, len(err.splitlines())) == (2, "", 1)
    assert "run it as root" in err
    assert is_left_clean(tmp_path)


def test_root_that_may_not_mount_gets_one_line_with_the_refusal(
    starts: Starts, tmp_path: Path
) -> None:
    as_in_a_container = "setpriv --bounding-set=-sys_admin" if os.geteuid() == 0 else ""
    unshare = f'exec {as_in_a_container} /usr/bin/unshare "$@"'
    check = starts(id="echo 0", unshare=unshare, debootstrap="echo not reached")
    out, err = check.communicate(timeout=60)
    assert (check.returncode, out, len(err.splitlines())) == (2, "", 1)
    assert "root may not mount here (unshare: unshare failed: Operation not permitted)" in err
    assert is_left_clean(tmp_path)


def test_a_debian_that_cannot_be_created_is_reported_and_removed(
    starts: Starts, tmp_path: Path
) -> None:
    need_mounts(AS_ROOT)
    check = starts("demo", debootstrap=f"{MAKE_A_TREE}\necho 'E: no such mirror'\nexit 1")
    _, err = check.communicate(timeout=60)
    assert check.returncode == 1
    assert "E: no such mirror" in err
    assert "check_bare_debian.sh: this step failed: Making a minimal Debian 12" in err
    assert is_left_clean(tmp_path)


def test_one_failing_command_fails_the_check_and_the_other_still_runs(
    starts: Starts, tmp_path: Path
) -> None:
    need_mounts(AS_ROOT)
    demo_fails = 'case "$*" in *scripts/demo.sh) exit 3 ;; esac'
    check = starts(debootstrap=MAKE_A_TREE, chroot=demo_fails, dpkg_query="echo 3.11.2-6")
    out, err = check.communicate(timeout=60)
    assert (check.returncode, err) == (1, "")
    assert "check_bare_debian.sh: demo failed (exit code 3) after " in out
    assert "check_bare_debian.sh: test passed in " in out
    assert " s on Debian 12.99 (python3 3.11.2-6)\n" in out
    assert is_left_clean(tmp_path)


@pytest.mark.parametrize("where", ["debootstrap", "chroot"])
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_check_leaves_nothing_behind(
    signum: signal.Signals, where: str, starts: Starts, tmp_path: Path
) -> None:
    need_mounts(AS_ROOT)
    stand_ins = {"debootstrap": MAKE_A_TREE}
    # What it starts ignores signals, and holds the output that is read to its end below.
    hangs = f"trap '' HUP INT TERM\nsleep 1000 &\ntouch {tmp_path}/hangs\nsleep 1000"
    check = starts("test", **stand_ins | {where: f"{stand_ins.get(where, '')}\n{hangs}"})
    wait_until((tmp_path / "hangs").exists)
    assert list((tmp_path / "roots").iterdir()) != []
    check.send_signal(signum)
    check.communicate(timeout=60)
    assert check.returncode == 128 + signum
    assert is_left_clean(tmp_path)
