"""Call a function in a process of its own, where it may hang or crash without harm.

Run as ``python -m vo_service.tools.doctor.subprocess_call``: takes a pickled function on standard input, leaves
its pickled result on standard output.
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
    """The result of `function`, a picklable one.

    Raises UserFacingError if it raised that, crashed, or was killed after `limit_s`.
    """
    command = [sys.executable, "-P", "-m", "vo_service.tools.doctor.subprocess_call"]
    try:
        done = subprocess.run(
            command,
            input=pickle.dumps(function),
            capture_output=True,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UserFacingError(f"no answer within {timeout_s:g} s") from error
    if done.returncode < 0:
        raise UserFacingError(f"crashed with {signal.Signals(-done.returncode).name}")
    if done.returncode > 0 or not done.stdout:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise UserFacingError(f"failed: {''.join(last)}")
    result = pickle.loads(done.stdout)
    if isinstance(result, UserFacingError):
        raise result
    return cast("T", result)


def _main() -> None:
    """Body of the child."""
    answer = os.dup(1)
    os.dup2(2, 1)  # whatever a native library prints is no answer
    function: Callable[[], object] = pickle.load(sys.stdin.buffer)
    result: object
    try:
        result = function()
    except UserFacingError as error:
        result = error
    with os.fdopen(answer, "wb") as file:
        pickle.dump(result, file)


if __name__ == "__main__":
    _main()
