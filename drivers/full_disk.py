"""Telling a full disk from every other reason why nothing can be written."""

import errno
import shutil
import sys
from pathlib import Path


def is_full(error: OSError) -> bool:
    """Whether there is no space left: on the disk, in a quota, or up to a limit of file sizes."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def free_bytes(folder: Path) -> int:
    """Bytes that are free on the folder's disk. Raises OSError.

    A file system without a size, as /proc and some on a network are, is never full by this.
    """
    usage = shutil.disk_usage(folder)
    return usage.free if usage.total else sys.maxsize
