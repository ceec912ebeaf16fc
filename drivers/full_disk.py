"""Telling a full disk from every other reason why nothing can be written."""

import errno


def is_full(error: OSError) -> bool:
    """Whether there is no space left: on the disk, in a quota, or up to a limit of file sizes."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
