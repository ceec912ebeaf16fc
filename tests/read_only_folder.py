"""A folder in which nothing can be created, also by root."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_VERSION_3 = 0x20080522
_CAP_DAC_OVERRIDE = 1
_libc = ctypes.CDLL(None, use_errno=True)


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _Sets(ctypes.Structure):
    # Effective, permitted and inheritable capabilities: the first 32, then the others.
    _fields_ = (("words", ctypes.c_uint32 * 6),)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let this thread, and those that it starts, create nothing in the folder."""
    header, sets = _Header(_VERSION_3, 0), _Sets()
    assert _libc.capget(ctypes.byref(header), ctypes.byref(sets)) == 0
    before = sets.words[0]
    folder.chmod(0o555)
    _set_effective(header, sets, before & ~(1 << _CAP_DAC_OVERRIDE))
    try:
        yield
    finally:
        _set_effective(header, sets, before)
        folder.chmod(0o755)


def _set_effective(header: _Header, sets: _Sets, effective: int) -> None:
    sets.words[0] = effective
    assert _libc.capset(ctypes.byref(header), ctypes.byref(sets)) == 0
