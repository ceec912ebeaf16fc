"""Call a function in a subprocess, where it may hang or crash without harm.

``python -m vo_service.tools.doctor.subprocess_call`` reads a pickled function from standard input
and writes its pickled result to standard output.
"""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import TypeVar, cast

from drivers.core.errors import UserFacingError

T = TypeVar("T")


def call_in_subprocess(function: Callable[[], T], timeout_s: float) -> T:
    """Return the result of a picklable function.

    Raises:
        UserFacingError: The function raised it, crashed, or was killed after `timeout_s`.
    """
    command = [sys.executable, "-P", "-m", "vo_service.tools.doctor.subprocess_call"]
    try:
        process = subprocess.run(
            command,
            input=pickle.dumps(function),
            capture_output=True,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UserFacingError(f"no answer within {timeout_s:g} s") from error
    if process.returncode < 0:
        raise UserFacingError(f"crashed with {signal.Signals(-process.returncode).name}")
    if process.returncode > 0 or not process.stdout:
        last_line = process.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise UserFacingError(f"failed: {''.join(last_line)}")
    result = pickle.loads(process.stdout)
    if isinstance(result, UserFacingError):
        raise result
    return cast("T", result)


def _main() -> None:
    """Run the function in the subprocess."""
    output = os.dup(1)
    os.dup2(2, 1)  # prints of native libraries must not mix with the result
    function: Callable[[], object] = pickle.load(sys.stdin.buffer)
    result: object
    try:
        result = function()
    except UserFacingError as error:
        result = error
    with os.fdopen(output, "wb") as file:
        pickle.dump(result, file)


if __name__ == "__main__":
    _main()
