"""Run system commands, with their errors in one line."""

import shutil
import subprocess

COMMAND_TIMEOUT_S = 20.0


def run_command(*command: str, timeout_s: float = COMMAND_TIMEOUT_S) -> str:
    """Run a system command; returns its error, or "" on success."""
    command_line = " ".join(command)
    if shutil.which(command[0]) is None:
        return f"{command[0]} is not installed here"
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"`{command_line}`: {error}"
    if process.returncode == 0:
        return ""
    return f"`{command_line}` failed: {' '.join(process.stderr.split())}"
