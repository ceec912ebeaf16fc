"""The check on an emulated aarch64: what it refuses before it downloads or compiles anything."""

import os
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.subprocess

SCRIPT = Path(__file__).parents[2] / "scripts" / "check_aarch64.sh"
# What the script needs before its first step; a Debian has more.
PROGRAMS = ("sh", "dirname")


@pytest.mark.parametrize(
    ("arguments", "machine", "why"),
    [
        (["orb"], "x86_64", "the method orb is unknown"),
        (["--help"], "x86_64", "the method --help is unknown"),
        (["icp"], "aarch64", "run it on x86_64: this computer is aarch64"),
        ([], "x86_64", "apt-get is missing: run it on a Debian"),
    ],
)
def test_what_is_missing_or_unknown_is_refused_in_one_line(
    arguments: list[str], machine: str, why: str, tmp_path: Path
) -> None:
    (programs := tmp_path / "bin").mkdir()
    (folder := tmp_path / "tmp").mkdir()
    for name in PROGRAMS:
        (programs / name).symlink_to(f"/usr/bin/{name}")
    (programs / "uname").write_text(f"#!/bin/sh\necho {machine}\n")
    (programs / "uname").chmod(0o755)
    check = subprocess.run(
        [SCRIPT, *arguments],
        env=os.environ | {"PATH": str(programs), "TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (check.returncode, check.stdout) == (2, "")
    (line,) = check.stderr.splitlines()
    assert line == f"check_aarch64.sh: {why}; see the head of scripts/check_aarch64.sh"
    assert list(folder.iterdir()) == []
