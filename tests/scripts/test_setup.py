"""The README's two commands where Debian packages are missing."""

import os
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.subprocess

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.mark.parametrize(("script", "packages"), [("demo.sh", ""), ("test.sh", " gcc libc6-dev")])
def test_a_user_without_sudo_gets_the_command_for_root(
    script: str, packages: str, tmp_path: Path
) -> None:
    stand_ins = {"id": "echo 1000", "dpkg-query": "exit 1", "sudo": "echo refused >&2; exit 1"}
    for name, body in stand_ins.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / name).chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    ended = subprocess.run(
        [SCRIPTS / script], env=os.environ | {"PATH": path}, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout) == (1, "")
    command = "run once as root: apt-get update && apt-get install --no-install-recommends ca-cert"
    assert command in ended.stderr
    assert f" libusb-1.0-0{packages}" in ended.stderr
