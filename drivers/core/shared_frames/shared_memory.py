"""The one place that creates shared memory.

There are two rings on top of it, because they promise the opposite. The ring of a camera
(`drivers.subprocess_camera.frame_ring`) has few slots of one size, and its reader owns a slot while
it copies: no frame is torn, a slow reader makes the camera wait (lockstep) or skips frames. The
ring of records (`record_ring`) never waits for a reader, keeps seconds of packed frames of any
length, and survives the death of the writer: a reader finds out afterwards whether a record was
overwritten.
"""

import os


def create_shared_memory(name: str, size: int) -> int:
    """Create memory for processes that inherit its file descriptor.

    It is a file without a name, which exists as long as one process holds it. Memory that is never
    touched is not allocated.

    Args:
        name: For /proc.
        size: Bytes.

    Returns:
        The file descriptor.

    Raises:
        OSError: There is not enough memory.
    """
    fd = os.memfd_create(name)
    try:
        os.ftruncate(fd, size)
    except OSError:
        os.close(fd)
        raise
    return fd
