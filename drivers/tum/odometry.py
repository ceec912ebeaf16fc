"""The file of a TUM folder with the odometry of a base's wheels."""

import base64
from collections.abc import Iterator
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import AppendOnlyFile
from drivers.tum.index_files import read_rows

ODOMETRY_FILE = "wheel_odom.txt"
# The message in base64 has all that the driver has sent, bit for bit.
COLUMNS = "timestamp message"


def read_odometry(folder: Path) -> Iterator[bytes]:
    """Yield the messages of a folder, CDR ``nav_msgs/msg/Odometry``; none without the file.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    path = folder / ODOMETRY_FILE
    for number, (_, text) in read_rows(path, COLUMNS) if path.exists() else []:
        try:
            message = base64.b64decode(text, validate=True)
        except ValueError as error:
            raise InputError(f"{path}:{number}: {error}; expected {COLUMNS}, in base64") from error
        yield message


class OdometryWriter:
    """Writes the file, which is created with the first message."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ODOMETRY_FILE
        self._files: list[AppendOnlyFile] = []

    def add(self, stamp: str, message: bytes) -> None:
        """Add a line; raises OSError."""
        if not self._files:
            self._files.append(AppendOnlyFile(self._path, COLUMNS))
        self._files[0].append(f"{stamp} {base64.b64encode(message).decode()}")

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        while self._files:
            self._files.pop().close()
