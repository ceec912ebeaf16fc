"""What a scripted camera does when it is told to: be absent, fail, crash, hang."""

import ctypes
import logging
import os
import threading
import time

from drivers.camera import FrameTimeout
from drivers.core import CameraError, CameraLostError, CameraNotFoundError, InputError

LONG_S = 3600


def pause(duration_s: float) -> None:
    """Let time pass in a camera."""
    time.sleep(duration_s)  # a camera's own pace, for which nobody can wait


def _raise_not_found() -> None:
    raise CameraNotFoundError("no scripted camera found; plug one in")


def _raise_busy() -> None:
    raise CameraError("the scripted camera is held by another process; end that")


def _raise_unplugged() -> None:
    raise CameraLostError("the scripted camera was unplugged")


def _raise_input_error() -> None:
    raise InputError("scripted.toml: no such file")


def _raise_unexpected() -> None:
    raise ValueError("strings in a tangle")


def _raise_timeout() -> None:
    raise FrameTimeout


def _exit() -> None:
    os.write(2, b"libscripted: out of strings\n")
    os._exit(1)


def _crash() -> None:
    os.write(1, b"libscripted: cutting a string\n")
    ctypes.string_at(0)


def _log_messages() -> None:
    logging.getLogger("scripted").warning("%d strings left", 2)
    os.write(2, b"libscripted: mind the strings\n")


def _hang() -> None:
    ctypes.CDLL(None).sleep(LONG_S)


def _hang_while_logging() -> None:
    threading.Thread(target=_log_forever, daemon=True).start()
    _hang()


def _log_forever() -> None:
    while True:
        _log_messages()
        pause(0.1)


def _hang_holding_gil() -> None:
    ctypes.PyDLL(None).sleep(LONG_S)


ACTIONS = {
    "absent": _raise_not_found,
    "busy": _raise_busy,
    "unplugged": _raise_unplugged,
    "wrong": _raise_input_error,
    "raise": _raise_unexpected,
    "silent": _raise_timeout,
    "exit": _exit,
    "crash": _crash,
    "say": _log_messages,
    "hang": _hang,
    "hang and talk": _hang_while_logging,
    "hang with lock": _hang_holding_gil,
}
