"""What a puppet does when it is told to: be absent, fail, crash, hang."""

import ctypes
import logging
import os
import threading
import time

from drivers.camera import NoFrameYet
from drivers.errors import CameraError, CameraLostError, CameraNotFoundError, InputError

LONG_S = 3600


def pause(duration_s: float) -> None:
    """Let time pass in a camera."""
    time.sleep(duration_s)  # a camera's own pace, for which nobody can wait


def _act_absent() -> None:
    raise CameraNotFoundError("no puppet found; plug one in")


def _act_busy() -> None:
    raise CameraError("the puppet is held by another process; end that")


def _act_unplugged() -> None:
    raise CameraLostError("the puppet was unplugged")


def _act_wrong() -> None:
    raise InputError("puppet.toml: no such file")


def _act_raise() -> None:
    raise ValueError("strings in a tangle")


def _act_silent() -> None:
    raise NoFrameYet


def _act_exit() -> None:
    os.write(2, b"libpuppet: out of strings\n")
    os._exit(1)


def _act_crash() -> None:
    os.write(1, b"libpuppet: cutting a string\n")
    ctypes.string_at(0)


def _act_say() -> None:
    logging.getLogger("puppet").warning("%d strings left", 2)
    os.write(2, b"libpuppet: mind the strings\n")


def _act_hang() -> None:
    ctypes.CDLL(None).sleep(LONG_S)


def _act_hang_and_talk() -> None:
    threading.Thread(target=_talk, daemon=True).start()
    _act_hang()


def _talk() -> None:
    while True:
        _act_say()
        pause(0.1)


def _act_hang_with_lock() -> None:
    ctypes.PyDLL(None).sleep(LONG_S)


ACTS = {
    "absent": _act_absent,
    "busy": _act_busy,
    "unplugged": _act_unplugged,
    "wrong": _act_wrong,
    "raise": _act_raise,
    "silent": _act_silent,
    "exit": _act_exit,
    "crash": _act_crash,
    "say": _act_say,
    "hang": _act_hang,
    "hang and talk": _act_hang_and_talk,
    "hang with lock": _act_hang_with_lock,
}
