"""Mounts of a test's own, which end with it: containers and some kernels refuse them."""

import subprocess
from functools import cache

import pytest

# An ordinary user is root in a user namespace, but may mount less there than root.
AS_ROOT = ("unshare", "--mount")
AS_MAPPED_ROOT = ("unshare", "--mount", "--map-root-user")


def need_mounts(unshare: tuple[str, ...]) -> None:
    """Skip the test if this system does not let `unshare` mount."""
    if refusal := _refusal(unshare):
        pytest.skip(f"needs to mount, which is refused here ({refusal})")


@cache
def _refusal(unshare: tuple[str, ...]) -> str:
    command = [*unshare, "mount", "-t", "tmpfs", "tmpfs", "/tmp"]
    tried = subprocess.run(command, capture_output=True, text=True, check=False)
    return tried.stderr.strip() if tried.returncode else ""
