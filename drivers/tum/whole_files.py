"""Writing so that a reader never sees half of anything, whenever this process may be killed."""

import os
from pathlib import Path


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, then give it its own. Raises OSError, leaving nothing.

    Survives a kill at any moment; not flushed to the disk itself, so after a power cut the newest
    files may be empty.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


class AppendOnlyFile:
    """A text file that grows by whole lines only."""

    def __init__(self, path: Path, header: str) -> None:
        """Create the file with a comment as its first line. Raises OSError."""
        self.path = path
        self._size = 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        self.append(f"# {header}")

    def append(self, line: str) -> None:
        """Add one line, or raise OSError and leave the file as it was."""
        data = f"{line}\n".encode()
        try:
            # One call, so a kill cannot come between two halves; a full disk can.
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError:
            os.ftruncate(self._fd, self._size)
            raise
        self._size = os.fstat(self._fd).st_size

    def close(self) -> None:
        """Close the file; nothing is buffered."""
        os.close(self._fd)
