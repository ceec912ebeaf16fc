"""Calling a program of the system, with its failure in one line."""

import shutil
import subprocess

COMMAND_TIMEOUT_S = 20.0


def run_command(*command: str, timeout_s: float = COMMAND_TIMEOUT_S) -> str:
    """Run a system command; "" or what went wrong."""
    told = " ".join(command)
    if shutil.which(command[0]) is None:
        return f"{command[0]} is not installed here"
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"`{told}`: {error}"
    return "" if done.returncode == 0 else f"`{told}` failed: {' '.join(done.stderr.split())}"
